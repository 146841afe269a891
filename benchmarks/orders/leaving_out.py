"""M6 with one of its parts left out, or with another way of choosing orders in its place.

The parts are private to `fringe3d.correspond`; they are exchanged here so that it need not know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.orders.voting import Unwrapping, by_library, deciding_by_vote, grown
from fringe3d.correspond import curves, solutions, solving, weighing
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.weighing import Task
from fringe3d.model import CalibrationBias

HERE = "fringe3d.correspond"

Patches = list[AbstractContextManager[Any]]


class NotInThisVersionError(LookupError):
    """The part has another name, or is no more."""


@contextmanager
def without(part: str, /) -> Iterator[None]:
    """Leave out one of `PARTS`; "" for none.

    Raises
    ------
    NotInThisVersionError
        If the part is not found.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(patch.object(Task, "_may_be_unlisted", lambda _: False))
            for change in PARTS[part]():
                stack.enter_context(change)
        except AttributeError as problem:
            raise NotInThisVersionError(f"{part}: {problem}") from None
        yield


def _each_pixel_alone() -> Patches:
    energy = Task._energy

    def alone(task: Task, costs: NDArray[np.float32]) -> NDArray[np.float32]:
        together, task.together = task.together, False
        try:
            return energy(task, costs)
        finally:
            task.together = together

    return [patch.object(Task, "_energy", alone)]


def _nothing_beyond() -> Patches:
    def own_ends(ends: NDArray[np.float32]) -> NDArray[np.float32]:
        return ends

    return [
        patch.object(curves, "expected_depths", own_ends),
        patch.object(weighing, "ray_curves", curves.traced_curves),
    ]


def _no_bias() -> Patches:
    """Judge with the calibration as it is; residuals may miss by what is expected of one."""

    def choose(
        task: Task, _bias: CalibrationBias | None, **_: Any
    ) -> tuple[Choice, CalibrationBias]:
        still = task.frame.constant((0.0, 0.0), scatter_px=weighing.EXPECTED_CALIBRATION_PX)
        return task.decide(still), still

    return [
        patch(f"{HERE}.candidates.rivals", lambda _tasks: None),
        patch(f"{HERE}.candidates.solve", choose),
        *_not_refined(),
    ]


def _not_refined() -> Patches:
    return [patch(f"{HERE}.candidates.rivals_around", lambda *_: None)]


def _one_start() -> Patches:
    return [patch.object(solutions, "STARTS_PX", (0.0,)), patch.object(solutions, "N_SURFACES", 0),
            patch.object(solutions, "N_LOOKS", 0)]  # fmt: skip


def _no_jumps() -> Patches:
    return [patch.object(solutions, "STEP_PENALTY", 0.0)]


def _no_way_back() -> Patches:
    def all_agree(task: Task, *_: Any, **__: Any) -> NDArray[np.bool_]:
        return np.ones(len(task.pixels), bool)

    return [patch(f"{HERE}.candidates.agrees_with_c2", all_agree)]


def _no_light_check() -> Patches:
    def none_foreign(task: Task, *_: Any, **__: Any) -> NDArray[np.bool_]:
        return np.zeros(len(task.pixels), bool)

    return [patch(f"{HERE}.candidates.takes_foreign_light", none_foreign)]


def _hidden_kept() -> Patches:
    def none_hidden(task: Task, *_: Any, **__: Any) -> NDArray[np.bool_]:
        return np.zeros(len(task.pixels), bool)

    return [patch(f"{HERE}.candidates.is_hidden", none_hidden)]


def _fragments_kept() -> Patches:
    def no_fragment(task: Task, *_: Any, **__: Any) -> NDArray[np.bool_]:
        return np.zeros(task.valid.shape, bool)

    return [patch(f"{HERE}.candidates.is_fragment", no_fragment)]


def _not_made_whole() -> Patches:
    return [patch.object(module, "made_whole", lambda _task, chosen, **_: chosen)
            for module in (solving, solutions)]  # fmt: skip


def _voting(unwrapping: Unwrapping) -> Callable[[], Patches]:
    return lambda: [deciding_by_vote(unwrapping), *_not_made_whole()]


PARTS: dict[str, Callable[[], Patches]] = {
    "": list,
    "neighbours: each pixel alone": _each_pixel_alone,
    "orders beyond the volume": _nothing_beyond,
    "bias": _no_bias,
    "refining of the stored bias": _not_refined,
    "several starts": _one_start,
    "jumps, where solutions are compared": _no_jumps,
    "surfaces made whole": _not_made_whole,
    "check both ways": _no_way_back,
    "check of the light": _no_light_check,
    "check of hidden points": _hidden_kept,
    "check of fragments": _fragments_kept,
    "neighbours: one vote for each region": _voting(grown),
    "neighbours: scikit-image's unwrap_phase, one vote for each region": _voting(by_library),
}
"""Names of the parts, as the table prints them."""
