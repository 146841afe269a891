"""The calibration's bias from recordings: once for a rig."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fringe3d.correspond import Task, rivals, tells_enough
from fringe3d.decode import decode
from fringe3d.errors import MethodError
from fringe3d.matching import best_direction_first, search_task
from fringe3d.model import CalibrationBias, Device, MeasuringVolume, Rig, Scan
from fringe3d.model.bias import SAME_ANGLE
from fringe3d.options import MeasureOptions, keep_images, volume_of

LEAST_CERTAINTY = 0.99
"""Weight of the solution that may be stored; a wrong one shifts every later surface."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LearntBias:
    """A bias, and how well the recordings determine it.

    Parameters
    ----------
    bias : CalibrationBias
    certainty : float, 0 to 1; mean weight of the solutions that give a pixel the same order, among
        all that the images leave possible
    n_solutions : int; solutions that are not ruled out
    decided_part : float; of the decoded pixels, those whose order this solution shares with all
    """

    bias: CalibrationBias
    certainty: float
    n_solutions: int
    decided_part: float


def learn_rig_bias(
    scans: Sequence[Scan],
    rig: Rig,
    options: MeasureOptions | None = None,
    /,
    *,
    step: Callable[[str, int, int], object] = lambda *_: None,
) -> LearntBias:
    """Learn what the calibration of a rig misses.

    Parameters
    ----------
    scans : Scan; of anything with structure. Any code in them helps, but four fringe images do
    rig : Rig with two cameras, projector and volume
    options : MeasureOptions or None; which of the images to use, and the depth range
    step : called with the work, what is done and what there is to do

    Returns
    -------
    LearntBias

    Raises
    ------
    MethodError
        If the rig or the recordings do not hold what is needed, or tell nothing.

    Notes
    -----
    See `fringe3d.correspond.rivals`. All recordings share one bias.
    """
    options = options or MeasureOptions()
    volume = volume_of(rig, rig.cameras[0].name, options)
    if len(rig.cameras) < 2 or rig.projector is None or volume is None:
        raise MethodError(
            "calibrate bias: expected a rig with two cameras, a projector and a measuring volume, "
            f"found {len(rig.cameras)} camera(s), {'a' if rig.projector else 'no'} projector and "
            f"{'a' if volume else 'no'} volume. Add what is missing to the rig file (a projector: "
            "fringe3d calibrate projector; a volume: --depth MIN:MAX)"
        )
    work = "preparing recordings"
    tasks = []
    for number, scan in enumerate(scans):
        step(work, number, len(scans))
        tasks.append(_task(scan, rig, rig.projector, volume, options))
    step(work, len(scans), len(scans))
    _require_one_bias(tasks, scans, rig)
    found = rivals(tasks)
    if found is None or not tells_enough(tasks, [task.decide(found.best) for task in tasks]):
        raise MethodError(
            "calibrate bias: expected a surface whose fringe orders are mostly clear, found too "
            "few such pixels. Take a well-structured scan, or one with a Gray code"
        )
    agree = found.agreements()
    source = ", ".join(scan.title or f"scan {number + 1}" for number, scan in enumerate(scans))
    return LearntBias(
        bias=replace(found.best, source=source),
        certainty=float(np.mean(agree)),
        n_solutions=len(found.solutions),
        decided_part=float(np.mean(agree > LEAST_CERTAINTY)),
    )


def _require_one_bias(tasks: Sequence[Task], scans: Sequence[Scan], rig: Rig) -> None:
    """Raise unless all scans show the bias that `measure` will apply."""
    pair = tuple(camera.name for camera in rig.cameras[:2])
    angle = tasks[0].views.phases1.angle
    for task, scan in zip(tasks, scans, strict=True):
        views, title = task.views, f"calibrate bias: scan '{scan.title}'"
        seen = (views.camera1.name, views.camera2.name)
        if seen != pair:
            raise MethodError(
                f"{title}: expected images of '{pair[0]}' and '{pair[1]}' first, the first two "
                f"cameras of the rig, found '{seen[0]}' and '{seen[1]}'. List the cameras in "
                "scan.toml in the order of rig.toml"
            )
        if abs(np.sin(views.phases1.angle - angle)) > SAME_ANGLE:
            raise MethodError(
                f"{title}: expected fringes at {np.degrees(angle):.0f} deg as in the first scan, "
                f"found {np.degrees(views.phases1.angle):.0f} deg: each direction has a bias of "
                "its own. Choose one (--direction x or y)"
            )


def _task(
    scan: Scan, rig: Rig, projector: Device, volume: MeasuringVolume, options: MeasureOptions
) -> Task:
    stacks = [keep_images(stack, options) for stack in scan.stacks]
    if len(stacks) < 2:
        raise MethodError(
            f"calibrate bias: scan '{scan.title}': expected images of two cameras, found "
            f"{len(stacks)}. Record with both cameras"
        )
    cameras = {camera.name: camera for camera in rig.cameras}
    camera1, camera2 = (cameras[stack.device_name] for stack in stacks[:2])
    phases = tuple(decode(stack, projector.shape) for stack in stacks)
    phases = best_direction_first(phases, camera1, camera2)
    return search_task(phases, camera1, camera2, projector, volume)
