"""What ``fringe3d evaluate paper`` tries: methods, and exactly the images that each needs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from fringe3d.model import PatternPlan, Scan
from fringe3d.options import Method
from fringe3d.patterns import method_plan, sequence

Planner = Callable[[tuple[int, int], float, int], PatternPlan]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A method as the report names it, and what it is given.

    What is tried with the fewest steps alone is tried in the hardest case.
    """

    name: str
    method: Method
    plan: Planner
    has_projector: bool = True
    strict: bool = False
    min_order_probability: float | None = None
    fewest_steps_alone: bool = False
    group: str = "paper"


def _images_of(method: str, *, reduced_bits: int = 2) -> Planner:
    def plan(shape: tuple[int, int], period_px: float, steps: int) -> PatternPlan:
        return method_plan(
            method, shape, period_px=period_px, n_shifts=steps, reduced_bits=reduced_bits
        )

    return plan


def _without_light_and_dark(gray: str) -> Planner:
    """Return the images of M2 without light and dark ones; `gray` is the kind of code."""

    def plan(shape: tuple[int, int], period_px: float, steps: int) -> PatternPlan:
        return sequence(shape, periods_px=(period_px,), n_shifts=steps, gray=gray, gray_bits=2)

    return plan


_M1 = Trial(name="M1", method="m1", plan=_images_of("m1"))
_M2 = Trial(name="M2", method="m2", plan=_images_of("m2"))
_M3 = Trial(name="M3", method="m3", plan=_images_of("m3"), min_order_probability=0.0)
"""As in the paper: the candidate that fits best, however little better than the next."""

_M4 = Trial(name="M4", method="m4", plan=_images_of("m4"))

PAPER_TRIALS = (
    _M1,
    Trial(name="M0", method="m0", plan=_images_of("m0")),
    _M2,
    _M3,
    _M4,
)
M5_TRIALS = (
    replace(_M1, name="M1 on the rig of M5"),
    Trial(name="M5", method="m5", plan=_images_of("m5")),
)
VARIANTS = tuple(
    replace(trial, group="variant", fewest_steps_alone=trial.name != "M2, no light, dark")
    for trial in (
        replace(_M2, name="M2, no light, dark", plan=_without_light_and_dark("complementary")),
        replace(_M2, name="M2, plain code", plan=_without_light_and_dark("plain")),
        replace(_M2, name="M2, no projector", has_projector=False),
        replace(_M3, name="M3, sure orders", min_order_probability=None),
    )
)
TABLE_TRIALS = tuple(
    replace(trial, group="table", fewest_steps_alone=True)
    for trial in (
        _M1,
        _M2,
        replace(_M2, name="M2, strict", strict=True),
        replace(_M2, name="M2, one bit more", plan=_images_of("m2", reduced_bits=3)),
        _M4,
        replace(_M4, name="M4, strict", strict=True),
    )
)
"""The code of M2 numbers the volume; one bit more numbers what lies below it, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A rig, what is behind the object, and what is tried there; M1 comes first, as reference."""

    preset: str
    background: str
    trials: tuple[Trial, ...]


SETTINGS = (
    Setting(preset="kolibri", background="none", trials=PAPER_TRIALS + VARIANTS),
    Setting(preset="kolibri-m5", background="none", trials=M5_TRIALS),
    Setting(preset="kolibri", background="table", trials=TABLE_TRIALS),
)


def tries_of(trials: Iterable[Trial], steps: tuple[int, ...], /) -> list[tuple[Trial, int]]:
    """Return each trial with each number of steps, the most first."""
    return [
        (trial, n)
        for n in steps
        for trial in trials
        if n == steps[-1] or not trial.fewest_steps_alone
    ]


def plans_of(
    trials: Iterable[Trial], steps: tuple[int, ...], shape: tuple[int, int], period_px: float, /
) -> dict[tuple[Trial, int], PatternPlan]:
    """Return the images of each trial and number of steps, for a projector (n_rows, n_cols)."""
    return {(t, n): t.plan(shape, period_px, n) for t, n in tries_of(trials, steps)}


def union_of(plans: Iterable[PatternPlan], /) -> PatternPlan:
    """Return one plan that holds the patterns of all, each once.

    Four of sixteen phase steps are the same images, and so are the fringes of all methods: they
    then have the same noise, and methods differ by what they do alone.
    """
    together = list(plans)
    patterns = dict.fromkeys(pattern for plan in together for pattern in plan.patterns)
    return PatternPlan(patterns=tuple(patterns), projector_shape=together[0].projector_shape)


def own_images(scan: Scan, together: PatternPlan, plan: PatternPlan, trial: Trial, /) -> Scan:
    """Return the recording as it would be with the images of one plan alone."""
    places = [together.patterns.index(pattern) for pattern in plan.patterns]
    rig = scan.rig
    if rig is not None and not trial.has_projector:
        rig = replace(rig, projector=None, covariance=None)
    return replace(scan, stacks=tuple(stack.subset(places) for stack in scan.stacks), rig=rig)
