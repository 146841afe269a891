"""Calibration errors: the rig as a calibration would give it, a little beside the truth.

Images are rendered with the true rig and measured with the perturbed one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fringe3d.geometry import epipolar_segment, pixel_grid, project, rays, sheet_crossing
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform
from fringe3d.patterns import across

Floats = NDArray[np.float64]

GRID = (12, 16)
"""Rows and columns of the viewing rays of C1 over which the displacement is averaged."""

N_DEPTHS = 5

N_ERRORS = 13
"""For each device: 3 of rotation, 3 of translation, 1 of focal length, 2 of the principal point,
4 of distortion (k1, k2, p1, p2)."""

MAX_SCALE_PX = 1e3
SCALE_TOLERANCE = 1e-6


def perturbed(rig: Rig, /, *, rms_px: float, seed: int, angle: float = 0.0) -> Rig:
    """Return a rig with small random errors of all poses and lenses.

    Parameters
    ----------
    rig : Rig with two cameras and a measuring volume
    rms_px : float, px, >= 0; root mean square of `displacements`, over the measuring volume
    seed : int, >= 0; the same seed gives the same errors, scaled by `rms_px`
    angle : float, rad; of the fringes by which the projector finds a point

    Returns
    -------
    Rig
        The same devices, sizes and volume; with `rms_px` 0 the rig itself.

    Raises
    ------
    ValueError
        If there is no second camera or no volume, or if `rms_px` is no number from 0 on.

    Notes
    -----
    Each of the 13 parameters of a device is drawn from a normal distribution. They are weighted
    so that each alone would move the image by as much at its border. All are scaled together: the
    displacement is almost proportional to the scale, and a root search finds the factor.

    Examples
    --------
    >>> from fringe3d.simulate.presets import kolibri
    >>> true = kolibri().rig
    >>> rig = perturbed(true, rms_px=0.05, seed=1)
    >>> round(float(np.sqrt((displacements(true, rig) ** 2).sum(-1).mean())), 6)
    0.05
    """
    if not 0 <= rms_px < np.inf:
        raise ValueError(f"perturb: rms_px: expected a number from 0 on, found {rms_px}")
    points = _points(rig)
    if rms_px == 0:
        return rig
    rng = np.random.default_rng(seed)
    errors = rng.standard_normal((len(rig.devices), N_ERRORS))
    middle = points.mean(axis=0)

    def excess(scale: float) -> float:
        found = _with_errors(rig, scale * errors, middle)
        moved = displacements(rig, found, points, angle=angle)
        return float(np.sqrt(np.mean((moved**2).sum(axis=-1)))) - rms_px

    high = rms_px
    while not excess(high) > 0:
        high *= 2
        if high > MAX_SCALE_PX:
            raise ValueError(f"perturb: rms_px: expected a small error, found {rms_px}")
    scale = brentq(excess, 0.0, high, xtol=SCALE_TOLERANCE * high)
    return _with_errors(rig, scale * errors, middle)


def displacements(
    true: Rig, found: Rig, points_mm: Floats | None = None, /, *, angle: float = 0.0
) -> Floats:
    """Return by how far a calibration misses the true image of points in C2.

    Parameters
    ----------
    true : Rig with two cameras; what the devices are
    found : Rig; what the calibration says that they are
    points_mm : (n, 3) float, mm, world frame, or None: points all over the measuring volume
    angle : float, rad; of the fringes

    Returns
    -------
    (n, 2) float64, px
        With a projector the *trinocular* displacement: the calibration's ray of C1 through the
        point's true pixel is cut with the light sheet of its true phase, and projected into C2.
        Without one the *epipolar* displacement: the shortest vector to the epipolar curve.
    """
    points = _points(true) if points_mm is None else points_mm
    c1, c2 = true.cameras[:2]
    origin, directions = rays(found.cameras[0], project(c1, points))
    depths = ((points - origin) * directions).sum(axis=-1)
    if true.projector is not None and found.projector is not None:
        lit = project(true.projector, points)
        w = across(angle, lit[:, 0], lit[:, 1])
        depths = sheet_crossing(found.projector, origin, directions, w, angle)

    def image(depths: Floats) -> Floats:
        return project(found.cameras[1], origin + depths[:, None] * directions)

    missed = image(depths) - project(c2, points)
    if true.projector is None or found.projector is None:
        step = 1e-4 * depths
        along = image(depths + step) - image(depths - step)
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        missed -= (missed * along).sum(axis=-1, keepdims=True) * along
    return missed


def _points(rig: Rig) -> Floats:
    """Return points of the measuring volume that all devices see, (n, 3), mm."""
    if len(rig.cameras) < 2 or rig.volume is None:
        raise ValueError(
            "perturb: expected a rig with two cameras and a measuring volume, found "
            f"{len(rig.cameras)} camera(s) and {'a' if rig.volume else 'no'} volume"
        )
    c1 = rig.cameras[0]
    grid = pixel_grid(GRID)
    scale = np.array([c1.n_cols / GRID[1], c1.n_rows / GRID[0]])
    pixels = ((grid + 0.5) * scale - 0.5).reshape(-1, 2)
    near, far = _common(rig.devices, pixels, rig.volume)
    hit = near < far
    if not hit.any():
        raise ValueError("perturb: expected a volume that all devices see, found none")
    parts = (np.arange(N_DEPTHS) + 0.5) / N_DEPTHS
    depths = near[hit, None] + parts * (far - near)[hit, None]
    origin, directions = rays(c1, pixels[hit])
    return np.asarray((origin + depths[..., None] * directions[:, None]).reshape(-1, 3))


def _common(
    devices: tuple[Device, ...], pixels: Floats, volume: MeasuringVolume
) -> tuple[Floats, Floats]:
    """Clip the rays of the first device by the volume and by the views of the others."""
    intervals = [epipolar_segment(devices[0], other, pixels, volume) for other in devices[1:]]
    near = np.max([near for near, _ in intervals], axis=0)
    far = np.min([far for _, far in intervals], axis=0)
    return near, far


def _with_errors(rig: Rig, errors: Floats, middle_mm: Floats) -> Rig:
    pairs = zip(rig.devices, errors, strict=True)
    devices = [_moved(device, row, middle_mm) for device, row in pairs]
    cameras = tuple(devices[: len(rig.cameras)])
    projector = devices[-1] if rig.projector is not None else None
    return replace(rig, cameras=cameras, projector=projector, covariance=None)


def _moved(device: Device, e: Floats, middle_mm: Floats) -> Device:
    """Return a device with errors that each move its image by so many pixels, at the border."""
    focal = float(device.focal_px.mean())
    radius = float(np.hypot(device.n_rows, device.n_cols)) / 2 / focal  # of the border, on z = 1
    distance = float(np.linalg.norm(middle_mm - device.center_world))
    turn = Rotation.from_rotvec(e[:3] / focal * [1.0, 1.0, 1.0 / radius])
    shift = e[3:6] * distance / focal * [1.0, 1.0, 1.0 / radius]
    pose = RigidTransform(rotation=turn.as_matrix(), translation=shift) @ device.device_from_world
    distortion = device.distortion.copy()
    powers = np.array([3, 5, 2, 2])  # of the radius: k1, k2, p1, p2
    distortion[:4] += e[9:] / focal / radius**powers
    return Device(
        name=device.name,
        role=device.role,
        n_rows=device.n_rows,
        n_cols=device.n_cols,
        focal_px=device.focal_px * (1 + e[6] / (focal * radius)),
        center_px=device.center_px + e[7:9],
        distortion=distortion,
        device_from_world=pose,
    )
