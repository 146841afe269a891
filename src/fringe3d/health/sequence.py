"""Whether the images are those that the sequence says; if not, which sequence they are of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fringe3d.health.agreement import agreement
from fringe3d.health.fault import Fault, Kind
from fringe3d.health.period import measured_period
from fringe3d.health.sampling import LitMap, neighbours
from fringe3d.model import Fringe, GrayBit, ImageStack, Pattern, PatternPlan, Uniform, Unused

N_PLACES, COARSE_STEP, N_FULL = 800, 6, 8
"""Pixels with four neighbours each; every sixth tells which stories are worth all of them."""

FAR_PART = 20
"""Of the smaller side of the image: how far the more distant neighbours lie."""

SUSPICIOUS = 0.06
"""Images in contradiction from which on other sequences are tried. Edges, noise and gamma may leave
as many, but then no other sequence is better."""

LEAST_GAIN = 0.04
"""Images in contradiction that another sequence must save."""

SOUND, SOUND_PER_IMAGE = 0.2, 0.008
"""Images in contradiction for each pixel that blur, gamma, edges and flicker explain: sound scans
have 0.04 to 0.12 of 4 to 44 images."""

CLEARLY_BETTER = 0.6
"""Of the contradictions: another sequence must leave fewer to be taken for the true one."""

PERIOD_STEP = 0.004
"""Of the period; over 60 periods a quarter of one."""

SAME_IMAGE = 0.35
"""Parts of what two patterns differ by at most (reached by 90 % of the pixels or more of codes, and
by a tenth of them of fringes): what an image differs from the same pattern's by is noise."""

DIFFERENT_PIXELS = 90


@dataclass(frozen=True, slots=True)
class _Story:
    """A sequence that the images may be of, and how it would differ from the plan."""

    kind: Kind
    patterns: tuple[Pattern, ...]
    text: str
    images: tuple[int, ...] = ()
    cure: str = ""


def check_sequence(stack: ImageStack, lit: LitMap, /) -> list[Fault]:
    """Compare the images with the plan; where they contradict it, find what they fit.

    Parameters
    ----------
    stack : ImageStack
    lit : LitMap

    Returns
    -------
    list of Fault; none where the images are those of the plan, else the likeliest story
    """
    plan = stack.plan
    grey = _sample(stack, lit)
    if grey.shape[2] == 0 or not (plan.fringe_sets or plan.gray_sets):
        return []
    limit = SOUND + SOUND_PER_IMAGE * plan.n_images
    found = _contradictions(grey, plan.patterns, plan)
    if found <= SUSPICIOUS:
        return []
    least, story = _likeliest(_stories(stack, lit, grey), grey, plan)
    is_better = least < min(CLEARLY_BETTER * found, found - LEAST_GAIN)
    if found <= limit and not is_better:
        return []
    figure = "images in contradiction for each pixel"
    where = f"camera '{stack.device_name}'"
    if story is None or not is_better:
        text = (
            f"{where}: the images do not fit the sequence ({found:.2f} of {plan.n_images} in "
            "contradiction for each pixel), nor any that differs by one mistake"
        )
        return [Fault(kind=Kind.SEQUENCE, camera=stack.device_name, figure=figure, value=found,
                      limit=limit, text=text)]  # fmt: skip
    text = (
        f"{where}: {story.text}: so {least:.2f} images contradict each other for each pixel, "
        f"{found:.2f} as described"
    )
    return [Fault(kind=story.kind, camera=stack.device_name, figure=figure, value=found,
                  limit=limit, text=text, cure=story.cure, images=story.images)]  # fmt: skip


def _sample(stack: ImageStack, lit: LitMap) -> NDArray[np.float32]:
    """Return grey values (n_images, 5, n) above black; of pixels that are not saturated if any."""
    usable = lit.lit & (lit.high < stack.saturation_dn)
    if usable.sum() < N_PLACES:
        usable = lit.lit
    rows, cols = neighbours(usable, N_PLACES, (max(2, min(stack.shape) // FAR_PART), 1)[::-1])
    return stack.images[:, rows, cols].astype(np.float32) - np.float32(stack.black_level_dn)


def _likeliest(
    stories: Iterable[_Story], grey: NDArray[np.float32], plan: PatternPlan
) -> tuple[float, _Story | None]:
    """Return the story that fits best, and how many images contradict each other by it."""
    some = grey[:, :, ::COARSE_STEP]
    tried = [(_contradictions(some, story.patterns, plan), story) for story in stories]
    best = sorted(tried, key=lambda pair: pair[0])[:N_FULL]
    judged = [(_contradictions(grey, story.patterns, plan), story) for _, story in best]
    return min(judged, key=lambda pair: pair[0], default=(float("inf"), None))


def _contradictions(
    grey: NDArray[np.float32], patterns: Sequence[Pattern], plan: PatternPlan
) -> float:
    """Return how many images contradict each other if they show these patterns.

    What is left out counts as one in contradiction: else the fewest images would be the best.
    """
    n_unused = sum(isinstance(p, Unused) for p in patterns)
    n_unused -= sum(isinstance(p, Unused) for p in plan.patterns)
    if not _decodable(patterns, plan):
        return float("inf")
    return agreement(grey, patterns, plan.projector_shape).contradictions + 0.02 * n_unused


def _decodable(patterns: Sequence[Pattern], plan: PatternPlan) -> bool:
    """Tell whether the fringe sets that remain determine phases."""
    sets = PatternPlan(patterns=tuple(patterns)).fringe_sets
    return len(sets) == len(plan.fringe_sets) and all(len(s.indices) >= 3 for s in sets)


def _stories(stack: ImageStack, lit: LitMap, grey: NDArray[np.float32]) -> Iterator[_Story]:
    """Yield what may have gone wrong: first how the recording is described, then single images."""
    yield from _described_wrongly(stack.plan)
    yield from _other_periods(stack, lit)
    repeated = _repeated(stack.plan, grey)
    yield from repeated
    yield from _missing(stack.plan)
    if not repeated:
        yield from _exchanged(stack.plan)


def _described_wrongly(plan: PatternPlan) -> Iterator[_Story]:
    fringes = [p for p in plan.patterns if isinstance(p, Fringe)]
    bits = [p for p in plan.patterns if isinstance(p, GrayBit)]
    if fringes:
        reverse = tuple(
            replace(p, shift=-p.shift) if isinstance(p, Fringe) else p for p in plan.patterns
        )
        yield _Story(Kind.SHIFT_DIRECTION, reverse,
                     "the fringes move the other way than the plan says")  # fmt: skip
    if bits:
        inverse = tuple(_inverted(p) for p in plan.patterns)
        other = tuple(_reordered(p, plan) for p in plan.patterns)
        yield _Story(
            Kind.GRAY_POLARITY, inverse, "bits of the Gray code are bright where the plan says dark"
        )
        yield _Story(Kind.GRAY_ORDER, other,
                     "the bits of the Gray code run the other way than the plan says")  # fmt: skip


def _inverted(pattern: Pattern) -> Pattern:
    if isinstance(pattern, GrayBit):
        return replace(pattern, inverted=not pattern.inverted)
    return pattern


def _reordered(pattern: Pattern, plan: PatternPlan) -> Pattern:
    if not isinstance(pattern, GrayBit):
        return pattern
    like = (pattern.angle, pattern.cell_px, pattern.n_bits, pattern.first_cell)
    code = next(g for g in plan.gray_sets if (g.angle, g.cell_px, g.n_bits, g.first_cell) == like)
    return replace(pattern, bit=code.bits[::-1][code.bits.index(pattern.bit)])


def _other_periods(stack: ImageStack, lit: LitMap) -> Iterator[_Story]:
    for fringe_set in stack.plan.fringe_sets:
        period = measured_period(stack, lit, fringe_set)
        if not np.isfinite(period):
            continue
        for factor in 1 + np.arange(-25, 26) * PERIOD_STEP:
            found = float(period * factor)
            patterns = tuple(
                replace(p, period_px=found)
                if isinstance(p, Fringe) and (p.period_px, p.angle) ==
                (fringe_set.period_px, fringe_set.angle) else p
                for p in stack.plan.patterns
            )  # fmt: skip
            yield _Story(Kind.PERIOD, patterns,
                         f"the fringes of {fringe_set.period_px:g} px have a period of about "
                         f"{found:.4g} px beside the Gray code")  # fmt: skip


def _repeated(plan: PatternPlan, grey: NDArray[np.float32]) -> list[_Story]:
    """Return the stories of images that show again what the one before showed."""
    span = np.ptp(grey, axis=0)
    found = []
    for place in range(1, plan.n_images):
        if plan.patterns[place] == plan.patterns[place - 1]:
            continue
        before, now = plan.patterns[place - 1], plan.patterns[place]
        if isinstance(before, Fringe) and isinstance(now, Fringe):
            alike = [i for i, p in enumerate(plan.patterns) if isinstance(p, Fringe)
                     and (p.period_px, p.angle) == (now.period_px, now.angle)]  # fmt: skip
            among = np.ptp(grey[alike], axis=0)
        else:
            among = span
        change = np.abs(grey[place] - grey[place - 1]) / np.maximum(among, 1)
        if np.percentile(change, DIFFERENT_PIXELS) > SAME_IMAGE * _largest_change(before, now):
            continue
        patterns = list(plan.patterns)
        again = [*patterns[:place], *patterns[place - 1 : -1]]
        patterns[place] = Unused()
        text = f"image {place} shows again what image {place - 1} shows"
        found.append(_Story(Kind.REPEATED_IMAGE, tuple(patterns), text, (place,)))
        again[place] = Unused()
        found.append(_Story(Kind.REPEATED_IMAGE, tuple(again),
                            f"{text}, and all later ones come one late", (place,)))  # fmt: skip
    return found


def _largest_change(a: Pattern, b: Pattern) -> float:
    """Return what two patterns differ by at most, parts of the span from dark to bright."""
    if isinstance(a, Fringe) and isinstance(b, Fringe) and a.period_px == b.period_px:
        return abs(float(np.sin((a.shift - b.shift) / 2)))
    return 1.0


def _missing(plan: PatternPlan) -> Iterator[_Story]:
    for place in range(plan.n_images - 1):
        moved = (*plan.patterns[:place], *plan.patterns[place + 1 :], Unused())
        yield _Story(Kind.MISSING_IMAGE, moved,
                     f"image {place} ({_words(plan.patterns[place])}) is missing, and all later "
                     "ones come one early", (place,))  # fmt: skip


def _exchanged(plan: PatternPlan) -> Iterator[_Story]:
    known = [i for i, p in enumerate(plan.patterns) if not isinstance(p, Unused)]
    for first, second in combinations(known, 2):
        patterns = list(plan.patterns)
        patterns[first], patterns[second] = patterns[second], patterns[first]
        names = [f"{i} ({_words(plan.patterns[i])})" for i in (first, second)]
        yield _Story(Kind.EXCHANGED_IMAGES, tuple(patterns),
                     f"images {names[0]} and {names[1]} are exchanged",
                     (first, second))  # fmt: skip


def _words(pattern: Pattern) -> str:
    match pattern:
        case Fringe():
            return f"step of {np.degrees(pattern.shift) % 360:.0f} degrees"
        case GrayBit():
            return f"bit {pattern.bit} of the Gray code"
        case Uniform():
            return "light" if pattern.level == 1 else "dark"
        case _:
            return "unused"
