"""What another calibration of the same devices makes of the same points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.calibrate.point_error import form_covariance, point_covariance
from fringe3d.errors import CalibrationError
from fringe3d.geometry import closest_depths, project, rays
from fringe3d.model import Device, Rig, RigCovariance

Floats = NDArray[np.float64]

LEAST_POINTS = 4
"""A motion and a scale take seven numbers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigComparison:
    """Two calibrations, compared at points of the measuring volume.

    Parameters
    ----------
    devices : (str, str); which were compared
    moved_mm : (..., 3) float, mm, frame of the first device
        Where the former calibration puts what lies at the points, minus the points; NaN where a
        device does not see them.
    form_mm : (..., 3) float, mm; the same without what a motion and a scale undo
    moved_sigma_mm, form_sigma_mm : (...) float, mm
        Standard deviations of the lengths of both that the covariances of the rigs let expect;
        NaN where no rig has one.
    scale : float; lengths by the former calibration over those by the new one
    counted : tuple of str; of "former" and "new", the rigs that have a covariance
    """

    devices: tuple[str, str]
    moved_mm: Floats
    form_mm: Floats
    moved_sigma_mm: Floats
    form_sigma_mm: Floats
    scale: float
    counted: tuple[str, ...]

    @property
    def moved_rms_mm(self) -> float:
        """Return the root mean square of the distances."""
        return _rms(self.moved_mm)

    @property
    def form_rms_mm(self) -> float:
        """Return the root mean square of what a motion and a scale leave."""
        return _rms(self.form_mm)


def compare_rigs(former: Rig, now: Rig, points_mm: ArrayLike, /) -> RigComparison:
    """Compare two calibrations of a rig.

    Parameters
    ----------
    former, now : Rig
    points_mm : (..., 3) float, mm, world frame of `now`; NaN where nothing is to be compared

    Returns
    -------
    RigComparison

    Raises
    ------
    CalibrationError
        If the rigs have not two devices of the same names and sizes, or too few points are seen.

    Notes
    -----
    The first two devices measure: the new calibration says in which pixels they see a point, the
    former one where the rays of these pixels meet. Each in the frame of its first device.
    """
    points = np.asarray(points_mm, np.float64)
    pairs = _same_devices(former, now)
    (first_then, first), (second_then, second) = pairs
    origin, directions = rays(first_then, project(first, points))
    origin2, directions2 = rays(second_then, project(second, points))
    t, t2 = closest_depths(origin, directions, origin2, directions2)
    then = (origin + t[..., None] * directions + origin2 + t2[..., None] * directions2) / 2
    here = first.device_from_world.apply(points)
    there = first_then.device_from_world.apply(then)
    seen = np.asarray(np.isfinite(here + there).all(axis=-1))
    if int(seen.sum()) < LEAST_POINTS:
        raise CalibrationError(
            "compare: expected points that both devices see with both calibrations, found "
            f"{int(seen.sum())}"
        )
    scale, fitted = _similar(here[seen], there[seen])
    form = np.full(points.shape, np.nan)
    form[seen] = there[seen] - fitted
    sides = {
        "former": ((first_then, second_then), former.covariance, then[seen]),
        "new": ((first, second), now.covariance, points[seen]),
    }
    known = {name: side for name, side in sides.items() if side[1] is not None}
    sigmas = np.full((2, *seen.shape), np.nan)
    if known:
        both = [_variances(devices, own, places) for devices, own, places in known.values()]
        sigmas[:, seen] = np.sqrt(np.sum(both, axis=0))
    return RigComparison(
        devices=(first.name, second.name),
        moved_mm=np.where(seen[..., None], there - here, np.nan),
        form_mm=form,
        moved_sigma_mm=sigmas[0],
        form_sigma_mm=sigmas[1],
        scale=scale,
        counted=tuple(known),
    )


def _variances(
    devices: tuple[Device, Device], covariance: RigCovariance | None, points: Floats
) -> tuple[Floats, Floats]:
    """Return the variances of the distances, and of the form, of points (n, 3), each (n,)."""
    assert covariance is not None
    moved, form = (of(devices, covariance, points) for of in (point_covariance, form_covariance))
    return np.trace(moved, axis1=1, axis2=2), np.trace(form, axis1=1, axis2=2)


def _same_devices(former: Rig, now: Rig) -> list[tuple[Device, Device]]:
    before = {device.name: device for device in former.devices}
    pairs = [(before[d.name], d) for d in now.devices if d.name in before]
    alike = [(then, d) for then, d in pairs if then.shape == d.shape]
    if len(alike) < 2 or alike[0][1].name != now.cameras[0].name:
        others = [
            f"{d.role} '{d.name}' has {d.n_cols} x {d.n_rows} pixels, formerly {then.n_cols} x "
            f"{then.n_rows}"
            for then, d in pairs
            if then.shape != d.shape
        ] or [f"{', '.join(before)} formerly, {', '.join(d.name for d in now.devices)} now"]
        raise CalibrationError(
            "compare: expected the first camera and another device of the same names and sizes in "
            f"both calibrations, found {'; '.join(others)}"
        )
    return alike[:2]


def _similar(points: Floats, targets: Floats) -> tuple[float, Floats]:
    """Return the scale of the similarity that maps points to targets best, and their images.

    Notes
    -----
    Umeyama (1991).
    """
    middle, aim = points.mean(axis=0), targets.mean(axis=0)
    left, stretch, right = np.linalg.svd((targets - aim).T @ (points - middle))
    handed = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left * handed @ right
    scale = float((stretch * handed).sum() / ((points - middle) ** 2).sum())
    return scale, np.asarray(scale * (points - middle) @ rotation.T + aim)


def _rms(vectors: Floats) -> float:
    return float(np.sqrt(np.nanmean((vectors**2).sum(axis=-1))))
