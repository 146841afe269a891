"""What was projected: patterns as data, in the order of the images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fringe3d.model.html import table

MAX_GRAY_BITS = 16
"""65 536 cells: more than any projector has columns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fringe:
    """One sinusoidal fringe image, ``A + B cos(2 pi w / period_px - shift)``.

    ``w = cos(angle) (u + 1/2) + sin(angle) (v + 1/2)`` is the coordinate across the fringes,
    measured from the projector's top-left corner; u, v are its pixel coordinates.

    Parameters
    ----------
    period_px : float, projector px, > 0; need not be an integer
    shift : float, rad; absorbs every convention of phase origin and direction of shift
    angle : float, rad; 0 for vertical fringes (direction x), pi/2 for horizontal ones (y)
    """

    period_px: float
    shift: float
    angle: float = 0.0

    def __post_init__(self) -> None:
        _require(np.isfinite(self.period_px) and self.period_px > 0, "period_px > 0", self)
        _require(np.isfinite([self.shift, self.angle]).all(), "a finite shift and angle", self)


@dataclass(frozen=True, slots=True, kw_only=True)
class GrayBit:
    """One image of a reflected Gray code: bit `bit` of ``gray((cell + first_cell) mod 2**n_bits)``.

    Cells are `cell_px` wide and counted along w from the projector's corner. A code is *cyclic*
    (reduced) when ``2**n_bits`` is less than the number of cells. A code with cells of half a
    period is *over-determined* (complementary): one bit more, and no edge where the phase wraps.

    Parameters
    ----------
    bit : int, 0 <= bit < n_bits; 0 is the finest (least significant)
    n_bits : int, 1..16
    cell_px : float, projector px, > 0
    angle : float, rad; as for `Fringe`
    inverted : bool; dark where the bit is 1
    first_cell : int; number of the cell at w = 0
    """

    bit: int
    n_bits: int
    cell_px: float
    angle: float = 0.0
    inverted: bool = False
    first_cell: int = 0

    def __post_init__(self) -> None:
        _require(1 <= self.n_bits <= MAX_GRAY_BITS, f"1 <= n_bits <= {MAX_GRAY_BITS}", self)
        _require(0 <= self.bit < self.n_bits, "0 <= bit < n_bits", self)
        _require(np.isfinite(self.cell_px) and self.cell_px > 0, "cell_px > 0", self)
        _require(np.isfinite(self.angle), "a finite angle", self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Uniform:
    """An image of one grey level: 1 is light, 0 is dark."""

    level: float

    def __post_init__(self) -> None:
        _require(0 <= self.level <= 1, "0 <= level <= 1", self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unused:
    """An image that belongs to the recording but that no method needs."""


Pattern = Fringe | GrayBit | Uniform | Unused


def _require(condition: bool | np.bool_, expected: str, pattern: object) -> None:
    if not condition:
        raise ValueError(f"pattern: expected {expected}, found {pattern}")


@dataclass(frozen=True, slots=True)
class FringeSet:
    """The fringe images of one period and angle: places in the stack, and shifts in rad."""

    period_px: float
    angle: float
    indices: tuple[int, ...]
    shifts: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class GraySet:
    """The Gray-code images of one cell width and angle.

    ``indices[i]`` is the place of bit ``bits[i]`` in the stack (MSB first) and ``inverses[i]``
    that of its inverse; -1 where there is none.
    """

    cell_px: float
    angle: float
    n_bits: int
    first_cell: int
    bits: tuple[int, ...]
    indices: tuple[int, ...]
    inverses: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PatternPlan:
    """An ordered sequence of patterns; pattern i was on the projector for image i.

    Parameters
    ----------
    patterns : sequence of Pattern
    projector_shape : (n_rows, n_cols) of the projector, or None where unknown

    Examples
    --------
    >>> plan = PatternPlan(patterns=fringes(16.0, 4) + gray_code(8.0, 7))
    >>> plan.n_images, plan.fringe_sets[0].period_px, plan.gray_sets[0].bits
    (11, 16.0, (6, 5, 4, 3, 2, 1, 0))
    """

    patterns: tuple[Pattern, ...]
    projector_shape: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if not self.patterns:
            raise ValueError("plan: expected at least one pattern, found none")

    @property
    def n_images(self) -> int:
        """Return the number of images that the sequence takes."""
        return len(self.patterns)

    @property
    def fringe_sets(self) -> tuple[FringeSet, ...]:
        """Return the fringe images grouped by angle and period, in order of appearance."""
        groups: dict[tuple[float, float], list[int]] = {}
        for index, pattern in enumerate(self.patterns):
            if isinstance(pattern, Fringe):
                groups.setdefault((pattern.period_px, pattern.angle), []).append(index)
        return tuple(
            FringeSet(period, angle, tuple(places), tuple(self._shift(i) for i in places))
            for (period, angle), places in groups.items()
        )

    @property
    def gray_sets(self) -> tuple[GraySet, ...]:
        """Return the Gray-code images grouped by angle and cell width, MSB first."""
        groups: dict[tuple[float, float, int, int], dict[tuple[int, bool], int]] = {}
        for index, pattern in enumerate(self.patterns):
            if isinstance(pattern, GrayBit):
                key = (pattern.cell_px, pattern.angle, pattern.n_bits, pattern.first_cell)
                groups.setdefault(key, {})[pattern.bit, pattern.inverted] = index
        return tuple(_gray_set(*key, places) for key, places in groups.items())

    @property
    def angles(self) -> tuple[float, ...]:
        """Return the fringe and code angles of the plan, rad, in order of appearance."""
        coded = (p.angle for p in self.patterns if isinstance(p, Fringe | GrayBit))
        return tuple(dict.fromkeys(coded))

    def uniform_index(self, level: float) -> int:
        """Return the place of the (last) image of this grey level, -1 where there is none."""
        places = [
            i for i, p in enumerate(self.patterns) if isinstance(p, Uniform) and p.level == level
        ]
        return places[-1] if places else -1

    @property
    def uniform_levels(self) -> tuple[tuple[float, int], ...]:
        """Return level and place of the uniform images, each level once, by level."""
        levels = {p.level: i for i, p in enumerate(self.patterns) if isinstance(p, Uniform)}
        return tuple(sorted(levels.items()))

    def subset(self, indices: Iterable[int]) -> PatternPlan:
        """Return the plan of a recording that keeps only these images."""
        return PatternPlan(
            patterns=tuple(self.patterns[i] for i in indices), projector_shape=self.projector_shape
        )

    def _repr_html_(self) -> str:
        rows = [
            (
                "fringes",
                f"{len(s.indices)} steps, period {s.period_px:g} px, {np.degrees(s.angle):g} deg",
            )
            for s in self.fringe_sets
        ]
        rows += [
            (
                "Gray code",
                f"{len(s.bits)} of {s.n_bits} bits, cells of {s.cell_px:g} px, "
                f"{np.degrees(s.angle):g} deg{' with inverses' * (max(s.inverses) >= 0)}",
            )
            for s in self.gray_sets
        ]
        uniform = sum(isinstance(pattern, Uniform) for pattern in self.patterns)
        rows += [("light and dark", f"{uniform} images")] * bool(uniform)
        return table(f"plan of {self.n_images} images", rows)

    def _shift(self, index: int) -> float:
        pattern = self.patterns[index]
        assert isinstance(pattern, Fringe)
        return pattern.shift


def _gray_set(
    cell_px: float,
    angle: float,
    n_bits: int,
    first_cell: int,
    places: dict[tuple[int, bool], int],
) -> GraySet:
    bits = tuple(sorted({bit for bit, _ in places}, reverse=True))
    return GraySet(
        cell_px=cell_px,
        angle=angle,
        n_bits=n_bits,
        first_cell=first_cell,
        bits=bits,
        indices=tuple(places.get((bit, False), -1) for bit in bits),
        inverses=tuple(places.get((bit, True), -1) for bit in bits),
    )


def fringes(
    period_px: float, n_shifts: int, *, angle: float = 0.0, reverse: bool = False
) -> tuple[Fringe, ...]:
    """Return `n_shifts` >= 3 fringe images with equal steps, ``shift = 2 pi n / n_shifts``.

    With `reverse` the steps go the other way (the fringes move towards smaller w).
    """
    if n_shifts < 3:
        raise ValueError(f"plan: expected at least 3 phase steps, found {n_shifts}")
    step = (-2 if reverse else 2) * np.pi / n_shifts
    return tuple(
        Fringe(period_px=period_px, shift=float(step * n), angle=angle) for n in range(n_shifts)
    )


def gray_code(
    cell_px: float, n_bits: int, *, angle: float = 0.0, inverses: bool = False
) -> tuple[GrayBit, ...]:
    """Return the images of a Gray code, MSB first, each followed by its inverse if asked."""
    return tuple(
        GrayBit(bit=bit, n_bits=n_bits, cell_px=cell_px, angle=angle, inverted=inverted)
        for bit in reversed(range(n_bits))
        for inverted in ((False, True) if inverses else (False,))
    )
