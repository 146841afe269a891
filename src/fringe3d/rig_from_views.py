"""The rig's own numbers from views of one body: where views overlap, a wrong rig contradicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import (
    Homologous,
    RigNumber,
    beforehand,
    changed,
    compare_rigs,
    contradictions,
    covariance_of,
    first_depths,
    numbers_of,
    placed,
    placing,
    point_shifts,
)
from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.geometry import rays
from fringe3d.model import Device, Registration, Rig, SurfaceView
from fringe3d.register import OverlapSystem, TablePrior, split_edges, surface_view

Floats = NDArray[np.float64]

N_SAMPLES = 1500
"""Points of each view that the overlaps rest on."""

MOST_ROUNDS, CONVERGED = 8, 0.05
"""Part of its sigma by which no number changes any more."""

SURE = 3.0
"""Root mean square of the changes in sigmas, from which on a rig is said to be off."""

HELD_PART, HELD_SCALE = 0.5, 1e-10
"""Combinations of numbers whose spread the data did not halve; variance of what is held exactly."""

NONE = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class RigChange:
    """By how much a number of the rig differs from the former calibration.

    Parameters
    ----------
    device, number : str; "turn_x" ... "shift_z" in the device frame, rad or mm, or "focal", a part
    value, sigma : float
    likely : float; how far it was likely to be off beforehand
    """

    device: str
    number: str
    value: float
    sigma: float
    likely: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigFromViews:
    """A rig as the overlaps of views show it.

    Parameters
    ----------
    rig : Rig; with the changes and their covariance, without a bias, which belonged to the former
    changes : tuple of RigChange
    in_sigmas : float; root mean square of the changes in units of what the data leave of them
    overlap_before_mm, overlap_mm : float, mm; median residual of the overlaps
    contradiction_before, contradiction : float; median of what the devices contradict each other
        by, in sigmas of the phases; NaN where nothing contradicts
    form_mm : float, mm; rms by which the form of the body changes; motion and scale are no form
    n_points : int; points that the overlaps rest on
    n_rounds : int
    """

    rig: Rig
    changes: tuple[RigChange, ...]
    in_sigmas: float
    overlap_before_mm: float
    overlap_mm: float
    contradiction_before: float
    contradiction: float
    form_mm: float
    n_points: int
    n_rounds: int

    @property
    def is_off(self) -> bool:
        """Tell whether the former rig was off by more than the data leave open."""
        return self.in_sigmas > SURE


@dataclass(slots=True, eq=False)
class _Track:
    """Homologous points of a scan on the grid of C1, with depths by the devices as they are."""

    view: SurfaceView
    points: Homologous
    index: NDArray[np.int32]
    depths: Floats = field(default_factory=lambda: np.zeros(0))

    def placed(self, devices: Sequence[Device]) -> SurfaceView:
        """Return the view as these devices see it; depths become theirs."""
        self.depths, world, sigma = placed(self.points, devices, self.depths)
        shape = devices[0].shape
        points, spread = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
        good = np.isfinite(world).all(axis=1) & np.isfinite(sigma)
        rows, cols = np.rint(self.points.pixels_c1[good, ::-1]).astype(int).T
        points[rows, cols], spread[rows, cols] = world[good], sigma[good]
        whole = surface_view(self.view.name, devices[0], points, spread,
                             position=self.view.position)  # fmt: skip
        if whole.camera.shape != shape:
            raise EmptyResultError(
                f"{self.view.name}: recalibrate: expected a view with neighbouring points, found "
                "one as of Gray code alone. Leave it out, or record fringes"
            )
        return split_edges(whole)[0]

    def shifts(
        self,
        pixels: Floats,
        ahead_mm: Floats,
        /,
        *,
        devices: Sequence[Device],
        numbers: Sequence[RigNumber],
    ) -> Floats:
        """Return how points move with the numbers, (n, 3, q); NaN where there is none.

        They lie at pixels (x, y) of C1, so much farther along their rays than those of the view.
        """
        found = np.full((len(pixels), 3, len(numbers)), np.nan)
        cols, rows = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(int).T
        inside = (rows >= 0) & (cols >= 0)
        inside &= (rows < self.index.shape[0]) & (cols < self.index.shape[1])
        which = np.full(len(pixels), NONE)
        which[inside] = self.index[rows[inside], cols[inside]]
        known = which != NONE
        if known.any():
            own, depths = self.points.subset(which[known]), self.depths[which[known]]
            length = np.linalg.norm(rays(devices[0], own.pixels_c1)[1], axis=-1)
            found[known] = point_shifts(own, devices, depths + ahead_mm[known] / length, numbers)
        return found


def rig_from_views(
    scans: Sequence[Homologous],
    views: Sequence[SurfaceView],
    rig: Rig,
    found: Registration,
    prior: TablePrior | None = None,
    /,
    *,
    step: Callable[[str, int, int], object] = lambda *_: None,
) -> RigFromViews:
    """Find poses and focal lengths of a rig's devices from all overlaps of registered views.

    Parameters
    ----------
    scans : sequence of Homologous; of the scan of each view
    views : sequence of SurfaceView; of the rig as it was believed to be
    rig : Rig; as it was believed to be
    found : Registration; of the views
    prior : TablePrior or None; how good the table is; None where views are free
    step : called with the work, what is done and what there is to do

    Returns
    -------
    RigFromViews

    Raises
    ------
    MethodError
        If the rig has one device alone.
    EmptyResultError
        If views are too sparse.

    Notes
    -----
    One least squares problem: poses of the views, the table with its axis, and the numbers of the
    rig. Residuals are distances of the views where they overlap, as in `fringe3d.register.adjust`,
    and what the devices contradict each other by, as in `fringe3d.calibrate.fit_poses`; each point
    is placed anew in every round by what the first two devices saw. The pose of C1 is the frame,
    its distance to the next device the scale: overlaps do not tell it.
    """
    devices = rig_devices(rig, scans)
    tracks = [_track(s, v, devices) for s, v in zip(scans, views, strict=True)]
    distance = float(np.median(np.concatenate([t.depths for t in tracks])))
    numbers = numbers_of(devices, distance)
    now, poses, off = devices, found.body_from_view, np.zeros(len(numbers))
    system = OverlapSystem(found.middle_mm, prior, N_SAMPLES)
    residuals, told = [], [contradictions(scans, devices, numbers)]
    for number in range(MOST_ROUNDS):
        step("recalibrating", number, MOST_ROUNDS)
        system.land([track.placed(now) for track in tracks], poses)
        residuals.append(system.residual_mm)
        likely, pull = beforehand(now, numbers, off)
        shifters = [partial(track.shifts, devices=now, numbers=numbers) for track in tracks]
        poses, change, covariance = system.solve(
            poses, shifters, told[-1].matrix + likely, told[-1].gradient + pull
        )
        off = off + change
        now = changed(devices, numbers, off)
        told.append(contradictions(scans, now, numbers))
        if (np.abs(change) <= CONVERGED * np.sqrt(np.diagonal(covariance))).all():
            break
    last = [track.placed(now) for track in tracks]
    system.land(last, poses)
    step("recalibrating", MOST_ROUNDS, MOST_ROUNDS)
    sigma = np.sqrt(np.diagonal(covariance))
    final = replace(rig.with_devices(now), covariance=covariance_of(now, numbers, covariance))
    return RigFromViews(
        rig=final,
        changes=tuple(RigChange(device=devices[n.device].name, number=n.name, value=float(v),
                                sigma=float(s), likely=n.likely)
                      for n, v, s in zip(numbers, off, sigma, strict=True)),
        in_sigmas=_in_sigmas(off, covariance, numbers),
        overlap_before_mm=residuals[0],
        overlap_mm=system.residual_mm,
        contradiction_before=told[0].in_sigmas,
        contradiction=told[-1].in_sigmas,
        form_mm=_form(rig, final, last[0]),
        n_points=system.n_points,
        n_rounds=number + 1,
    )  # fmt: skip


def rig_devices(rig: Rig, scans: Sequence[Homologous], /) -> tuple[Device, ...]:
    """Return C1, the further cameras that see points of all scans, and the projector.

    Raises
    ------
    MethodError
        If there is no second device.
    """
    seen = set.intersection(*({s.device for s in scan.sights} for scan in scans))
    cameras = (rig.cameras[0], *(c for c in rig.cameras[1:] if c.name in seen))
    devices = (*cameras, rig.projector) if rig.projector is not None else cameras
    if len(devices) < 2:
        raise MethodError("recalibrate: expected a rig of two devices or more, found one")
    return devices


def _track(points: Homologous, view: SurfaceView, devices: Sequence[Device]) -> _Track:
    """Return the points that the first two devices place, with the depths of these devices."""
    own = placing(points, devices)
    depths = first_depths(own, devices)
    good = np.isfinite(depths) & (depths > 0)
    own, depths = own.subset(np.flatnonzero(good)), depths[good]
    index = np.full(devices[0].shape, NONE, np.int32)
    cols, rows = np.rint(own.pixels_c1).astype(int).T
    index[rows, cols] = np.arange(own.n_points)
    return _Track(view, own, index, depths)


def _in_sigmas(off: Floats, covariance: Floats, numbers: Sequence[RigNumber]) -> float:
    """Return the rms of the changes in units of their sigmas, over what the data determine."""
    likely = np.array([n.likely for n in numbers])
    spread, axes = np.linalg.eigh(covariance / np.outer(likely, likely))
    # What the data did not halve stays where it was; the scale is held by convention.
    told = (spread < HELD_PART**2) & (spread > HELD_SCALE)
    if not told.any():
        return 0.0
    along = axes[:, told].T @ (off / likely)
    return float(np.sqrt(np.mean(along**2 / spread[told])))


def _form(former: Rig, now: Rig, view: SurfaceView) -> float:
    """Return by how much the form of what a view saw changes, rms, mm."""
    points = view.points_mm[view.is_valid]
    every = max(1, len(points) // N_SAMPLES)
    return compare_rigs(former, now, points[::every]).form_rms_mm
