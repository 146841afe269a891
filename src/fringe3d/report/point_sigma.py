"""The part of the points' uncertainty that comes from the calibration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import point_covariance
from fringe3d.model import Scan
from fringe3d.pipeline import Measurement

CHUNK = 20_000


def calibration_sigma_mm(scan: Scan, result: Measurement, /) -> NDArray[np.float32] | None:
    """Return the standard deviation of points along the viewing rays of C1, from the calibration.

    It is kept apart from that of the noise: neighbouring points err alike by it, and averaging does
    not lessen it.

    Parameters
    ----------
    scan : Scan
    result : Measurement of it, with points

    Returns
    -------
    (row, col) float32, mm, or None
        NaN where there is no point; None if the rig does not say how certain it is.
    """
    rig, points = scan.rig, result.points
    if rig is None or rig.covariance is None or points is None:
        return None
    camera = next(c for c in rig.cameras if c.name == result.main.device_name)
    other = rig.projector
    if result.method != "projector":
        other = next(c for c in rig.cameras if c.name == result.phases[1].device_name)
    assert other is not None
    good = points.is_valid
    found = points.points_mm[good]
    rays = found - camera.center_world
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    variance = np.empty(len(found))
    for start in range(0, len(found), CHUNK):
        part = slice(start, start + CHUNK)
        covariance = point_covariance((camera, other), rig.covariance, found[part])
        variance[part] = np.einsum("ni,nij,nj->n", rays[part], covariance, rays[part])
    sigma = np.full(good.shape, np.nan, np.float32)
    sigma[good] = np.sqrt(np.maximum(variance, 0))
    return sigma
