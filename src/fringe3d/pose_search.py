"""Fringe orders of a rig that was moved, from scans that do not number them.

A device that turned by a hundredth of a degree moves points in the second camera as far as another
fringe order does. But it moves all of them alike: so the second camera is turned in steps, all over
what is likely, until the orders of all pixels fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.correspond import DOUBT, FIT_SIGMA, Rivals, Task, coarse_stride, rivals
from fringe3d.decode import CameraPhases
from fringe3d.geometry import closest_depths, project, rays
from fringe3d.matching import two_views
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform

REACH_PX, STEP_PX = 6.0, 1.2
"""In the second camera: how far its points may have moved together (0.1 degrees at 3400 px, each
way), and a step after which the evidence still finds its way."""

LEAST_CERTAINTY = 0.99


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
    found = rivals([_task(phases, rig, volume) for phases in scans])
    if found is None:
        return None
    agree = [
        found.agreement(task.views.phases1.phase.shape, number=number, doubt=DOUBT)[task.grid][
            task.valid
        ]
        for number, task in enumerate(found.tasks)
    ]
    best = replace(rig, bias=replace(found.best, source="self-calibration"))
    return Fit(best, found, float(np.mean(np.concatenate(agree))))


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
        fit = fit_as_it_is(scans, _turned(rig, scans[0], float(turn)), volume)
        fits += [fit] if fit is not None else []
    step(len(turns), len(turns))
    if not fits:
        return None
    best = min(fits, key=lambda fit: fit.energy)
    others = [f for f in fits if not f.found.solutions[0].resembles(best.found.solutions[0])]
    odds = sum(float(np.exp((best.energy - f.energy) / DOUBT)) for f in others)
    return replace(best, certainty=best.certainty / (1 + odds))


def _task(phases: Sequence[CameraPhases], rig: Rig, volume: MeasuringVolume) -> Task:
    """Return the candidates of a scan on a coarse grid, by its first fringes alone."""
    assert rig.projector is not None
    camera1, camera2 = _cameras(rig, phases)
    views = replace(two_views(phases, camera1, camera2), second1=None, second2=None,
                    periods1=(), periods2=())  # fmt: skip
    stride = coarse_stride(views.phases1.phase)
    return Task(views, rig.projector, volume, FIT_SIGMA**2, together=True, stride=stride)


def _cameras(rig: Rig, phases: Sequence[CameraPhases]) -> tuple[Device, Device]:
    cameras = {camera.name: camera for camera in rig.cameras}
    return cameras[phases[0].device_name], cameras[phases[1].device_name]


def _turned(rig: Rig, phases: Sequence[CameraPhases], distance_px: float) -> Rig:
    """Return the rig with its second camera turned, so that points move along epipolar lines."""
    camera1, camera2 = _cameras(rig, phases)
    x, y = distance_px * _epipolar_way(camera1, camera2) / camera2.focal_px
    turn = RigidTransform(
        rotation=Rotation.from_rotvec([-y, x, 0.0]).as_matrix(), translation=[0, 0, 0]
    )
    moved = replace(camera2, device_from_world=turn @ camera2.device_from_world)
    return replace(rig, cameras=tuple(moved if c is camera2 else c for c in rig.cameras))


def _epipolar_way(camera1: Device, camera2: Device) -> NDArray[np.float64]:
    """Return the direction, (2,), in which C2 sees a point in the middle move away from C1."""
    (origin, direction), other = (
        rays(c, np.array([[c.n_cols / 2, c.n_rows / 2]])) for c in (camera1, camera2)
    )
    depth, _ = closest_depths(origin, direction, *other)
    ends = project(camera2, origin + np.outer([depth[0], 1.001 * depth[0]], direction[0]))
    way = ends[1] - ends[0]
    return np.asarray(way / np.linalg.norm(way))
