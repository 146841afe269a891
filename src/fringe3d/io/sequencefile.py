"""``[[sequence]]`` entries: what was projected, as scan and plan files say it."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from fringe3d.io.toml import StrictModel
from fringe3d.model import Fringe, GrayBit, Pattern, Uniform, Unused
from fringe3d.model.plan import MAX_GRAY_BITS


class _Striped(StrictModel):
    """Common keys of patterns with a direction."""

    direction: Literal["x", "y"] = "x"
    angle_deg: float | None = None

    @property
    def angle(self) -> float:
        """Return the angle of the stripes, rad."""
        if self.angle_deg is not None:
            return math.radians(self.angle_deg)
        return 0.0 if self.direction == "x" else math.pi / 2


class FringesTable(_Striped):
    """Phase-shifted fringes, in the convention of the software that projected them.

    It computed, for its coordinate x of a pixel, ``A + B cos(2 pi x / period_px + phase_offset
    - shift_direction * 2 pi n / n_shifts)``, where x of the first column (row) is
    `first_coordinate`.
    """

    kind: Literal["fringes"]
    period_px: PositiveFloat
    n_shifts: Annotated[int, Field(ge=3)] | None = None
    shifts_deg: list[float] | None = None
    shift_direction: Literal[1, -1] = 1
    phase_offset_deg: float = 0.0
    first_coordinate: float = 0.5

    @model_validator(mode="after")
    def _one_kind_of_steps(self) -> FringesTable:
        if (self.n_shifts is None) == (self.shifts_deg is None):
            raise ValueError("expected either n_shifts (equal steps) or shifts_deg, not both")
        return self

    def patterns(self) -> list[Pattern]:
        """Return the fringe images in our convention: everything goes into the shift."""
        if self.shifts_deg is not None:
            steps = [math.radians(step) for step in self.shifts_deg]
        else:
            steps = [2 * math.pi * n / (self.n_shifts or 1) for n in range(self.n_shifts or 0)]
        # x = w - 1/2 + first_coordinate, for w = u + 1/2.
        axis = math.cos(self.angle) + math.sin(self.angle)
        origin = 2 * math.pi * (self.first_coordinate - 0.5) * axis / self.period_px
        offset = math.radians(self.phase_offset_deg) + origin
        return [
            Fringe(
                period_px=self.period_px,
                shift=self.shift_direction * step - offset,
                angle=self.angle,
            )
            for step in steps
        ]


class GrayTable(_Striped):
    """Gray-code images.

    Cells are counted from the projector's edge, the first one being `first_cell`. `bits` names
    the recorded bits where not all of them follow in the order of significance (0 is finest).
    """

    kind: Literal["gray"]
    cell_px: PositiveFloat
    n_bits: Annotated[int, Field(ge=1, le=MAX_GRAY_BITS)]
    bits: list[int] | None = None
    order: Literal["msb-first", "lsb-first"] = "msb-first"
    inverses: Literal["none", "interleaved", "after", "only"] = "none"
    bright_is: Literal[0, 1] = 1
    first_cell: int = 0

    def patterns(self) -> list[Pattern]:
        """Return the images of the code in the recorded order."""
        bits = list(range(self.n_bits)) if self.bits is None else self.bits
        if self.bits is None and self.order == "msb-first":
            bits = bits[::-1]
        plain, inverse = self.bright_is == 0, self.bright_is == 1
        recorded = {
            "none": [(bit, plain) for bit in bits],
            "only": [(bit, inverse) for bit in bits],
            "interleaved": [(bit, flip) for bit in bits for flip in (plain, inverse)],
            "after": [(bit, plain) for bit in bits] + [(bit, inverse) for bit in bits],
        }[self.inverses]
        return [
            GrayBit(
                bit=bit,
                n_bits=self.n_bits,
                cell_px=self.cell_px,
                angle=self.angle,
                inverted=inverted,
                first_cell=self.first_cell,
            )
            for bit, inverted in recorded
        ]


class LightTable(StrictModel):
    """An image of full light."""

    kind: Literal["light"]

    def patterns(self) -> list[Pattern]:
        """Return the image."""
        return [Uniform(level=1.0)]


class DarkTable(StrictModel):
    """An image without light from the projector."""

    kind: Literal["dark"]

    def patterns(self) -> list[Pattern]:
        """Return the image."""
        return [Uniform(level=0.0)]


class RampTable(StrictModel):
    """Uniform images of several grey levels, 0 dark to 1 light: a grey ramp."""

    kind: Literal["ramp"]
    levels: Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=1)]

    def patterns(self) -> list[Pattern]:
        """Return the images."""
        return [Uniform(level=level) for level in self.levels]


class UnusedTable(StrictModel):
    """Images that no method needs."""

    kind: Literal["unused"]
    count: PositiveInt = 1

    def patterns(self) -> list[Pattern]:
        """Return the images."""
        return [Unused()] * self.count


SequenceTable = Annotated[
    FringesTable | GrayTable | LightTable | DarkTable | RampTable | UnusedTable,
    Field(discriminator="kind"),
]
