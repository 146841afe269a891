"""Two cameras and a known fringe order: the point close to where C2 should see its light sheet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _near
from fringe3d.correspond.direct import Located
from fringe3d.correspond.stereo import spans_of
from fringe3d.geometry import grid_intervals, grid_rays, pixel_centres
from fringe3d.geometry.projection import lens_of
from fringe3d.kernels import over_rows
from fringe3d.model import NO_ORDER, Correspondences, Device, MeasuringVolume, PhaseMap

NO_OTHERS = np.empty((0, 0), np.int32), np.empty((0, 0), np.float32)
"""No orders of C2 and no other direction: see `_search.scan`."""


def match_near_sheets(
    phases1: PhaseMap,
    phases2: PhaseMap,
    camera1: Device,
    camera2: Device,
    projector: Device,
    volume: MeasuringVolume,
    half_px: NDArray[np.float32],
    /,
    *,
    rejection: NDArray[np.uint16] | None = None,
    located: Located | None = None,
) -> Correspondences:
    """Find in C2 the point with the phase of each pixel of C1, near the light sheet of its order.

    Within a part of a period the wrapped phase alone marks the point. From where the projector's
    calibration expects it, the phase of C2 is followed along the epipolar curve (exact, with
    distortion); where the phase rises all along the part that is searched, there is no second
    point. Elsewhere that part is scanned in steps of half a pixel, as in `match_cameras`.

    Parameters
    ----------
    phases1, phases2 : PhaseMap of C1, absolute, and of C2, of the same fringes
    camera1, camera2, projector : Device
    volume : MeasuringVolume
    half_px : (row, col) float32, projector px; how far around its phase C2 sees the point
    rejection : (row, col) uint16 or None; pixels to leave out, if other than those of phases1;
        reasons are added to it
    located : Located or None; what is known already, to which the points that are left are added

    Returns
    -------
    Correspondences
        OUTSIDE_VOLUME where no part of the volume is near the sheet, OUTSIDE_VIEW where C2 cannot
        see it, NO_MATCH where no point has the phase, AMBIGUOUS where several have.

    Notes
    -----
    ``sigma_px = sqrt(sigma_1**2 + sigma_2**2 4/9) / |d phi_2 / ds|``.
    """
    shape = phases1.rejection.shape
    origin, directions = grid_rays(camera1)
    to_projector, to_c2 = projector.device_from_world, camera2.device_from_world
    angle = phases1.angle
    if located is None:
        pixels, sigma = np.empty((*shape, 2)), np.empty(shape, np.float32)
        todo = np.ones(shape, np.bool_)
    else:
        pixels, sigma, todo = located.pixels, located.sigma_px, located.todo
    rejection = phases1.rejection.copy() if rejection is None else rejection
    over_rows(
        _near.search_near,
        shape[0],
        (phases1.phase, phases1.order_class, phases1.phase_std, phases1.period_px),
        half_px,
        directions,
        grid_intervals(camera1, camera2, volume),
        (to_projector.apply(origin), to_projector.rotation, lens_of(projector),
         np.array([np.cos(angle), np.sin(angle)])),
        (to_c2.apply(origin), to_c2.rotation, lens_of(camera2)),
        (phases2.phase, spans_of(phases2.phase), phases2.phase_std),
        NO_OTHERS,
        todo,
        (pixels, sigma, rejection),
    )  # fmt: skip
    return Correspondences(
        device_name=camera2.name,
        pixels_c1=pixel_centres(shape),
        pixels=pixels,
        sigma_px=sigma,
        epipolar_residual_px=np.broadcast_to(np.float32(np.nan), shape),
        fringe_order=np.where(rejection == 0, phases1.order_class, np.int32(NO_ORDER)),
        rejection=rejection,
    )
