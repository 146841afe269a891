"""Fringe orders of a rig that was moved, from scans that do not number them.

A device that turned by a hundredth of a degree moves points in the second camera as far as another
fringe order does. But it moves all of them alike: so the second camera is turned in steps, all over
what is likely, until the orders of all pixels fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fringe3d.correspond import (
    DOUBT,
    Rivals,
    Solution,
    Task,
    epipolar_direction,
    rivals,
    tells_enough,
)
from fringe3d.decode import CameraPhases
from fringe3d.geometry import depth_interval, pixel_grid, rays
from fringe3d.matching import search_task
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform

REACH_PX, STEP_PX = 6.0, 1.2
"""In the second camera: how far its points may have moved together (0.1 degrees at 3400 px, each
way), and a step after which the evidence still finds its way."""

LEAST_CERTAINTY = 0.95

STEP = 16
"""Rows and columns of pixels whose rays show in which direction points move."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A rig, what its images leave possible, and how certain its orders are, 0 to 1."""

    rig: Rig
    found: Rivals
    certainty: float

    @property
    def energy(self) -> float:
        """Return what speaks against the best solution."""
        return self.found.solutions[0].energy


def fit_as_it_is(
    scans: Sequence[Sequence[CameraPhases]], rig: Rig, volume: MeasuringVolume, /
) -> Fit | None:
    """Return the orders and the bias that fit a rig; None where nothing is clear.

    Parameters
    ----------
    scans : CameraPhases of both cameras for each scan; one direction
    rig : Rig with two cameras and a projector
    volume : MeasuringVolume
    """
    tasks = [_task(phases, rig, volume) for phases in scans]
    found = rivals(tasks)
    if found is None or not tells_enough(tasks, [task.decide(found.best) for task in tasks]):
        return None
    # These images are no new evidence for it: without a covariance it serves them as it is.
    bias = replace(found.best, source="self-calibration", covariance_px2=None)
    return Fit(replace(rig, bias=bias), found, float(np.mean(found.agreements())))


def fit_turned(
    scans: Sequence[Sequence[CameraPhases]],
    rig: Rig,
    volume: MeasuringVolume,
    /,
    *,
    step: Callable[[int, int], object] = lambda *_: None,
) -> Fit | None:
    """Turn the second camera until the orders fit best; None where nothing is clear anywhere.

    Parameters
    ----------
    scans, rig, volume : as of `fit_as_it_is`
    step : called with what is done and what there is to do

    Returns
    -------
    Fit
        Its certainty counts the solutions at other turns, too.
    """
    n = int(np.ceil(REACH_PX / STEP_PX))
    turns = STEP_PX * np.arange(-n, n + 1)
    fits = []
    for number, turn in enumerate(turns):
        step(number, len(turns))
        fit = fit_as_it_is(scans, _turned(rig, scans[0], volume, float(turn)), volume)
        fits += [fit] if fit is not None else []
    step(len(turns), len(turns))
    if not fits:
        return None
    best = min(fits, key=lambda fit: fit.energy)
    own = list(best.found.solutions)
    others: list[Solution] = []
    for solution in sorted((s for f in fits for s in f.found.solutions), key=lambda s: s.energy):
        if not any(solution.resembles(known) for known in (*own, *others)):
            others.append(solution)
    odds = sum(float(np.exp((best.energy - s.energy) / DOUBT)) for s in others)
    return replace(best, certainty=best.certainty / (1 + odds))


def _task(phases: Sequence[CameraPhases], rig: Rig, volume: MeasuringVolume) -> Task:
    """Return the candidates of a scan on a coarse grid, by its first fringes alone."""
    assert rig.projector is not None
    camera1, camera2 = _cameras(rig, phases)
    return search_task(phases, camera1, camera2, rig.projector, volume)


def _cameras(rig: Rig, phases: Sequence[CameraPhases]) -> tuple[Device, Device]:
    cameras = {camera.name: camera for camera in rig.cameras}
    return cameras[phases[0].device_name], cameras[phases[1].device_name]


def _turned(
    rig: Rig, phases: Sequence[CameraPhases], volume: MeasuringVolume, distance_px: float
) -> Rig:
    """Return the rig with its second camera turned, so that points move along epipolar lines."""
    camera1, camera2 = _cameras(rig, phases)
    pixels = pixel_grid(camera1.shape)[::STEP, ::STEP].reshape(-1, 2)
    middle = float(np.nanmedian(depth_interval(*rays(camera1, pixels), volume)))
    way = epipolar_direction(camera1, camera2, pixels, middle)
    x, y = distance_px * way / camera2.focal_px
    turn = RigidTransform(
        rotation=Rotation.from_rotvec([-y, x, 0.0]).as_matrix(), translation=[0, 0, 0]
    )
    moved = replace(camera2, device_from_world=turn @ camera2.device_from_world)
    return replace(rig, cameras=tuple(moved if c is camera2 else c for c in rig.cameras))
