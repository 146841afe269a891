"""``scan.toml`` and ``plan.toml``: what was projected, and where the images are."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Literal

import tomlkit
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from fringe3d.errors import PlanError
from fringe3d.io.images import Channel
from fringe3d.io.sequencefile import (
    DarkTable,
    FringesTable,
    GrayTable,
    LightTable,
    RampTable,
    SequenceTable,
    UnusedTable,
)
from fringe3d.io.toml import StrictModel, read_toml
from fringe3d.model import (
    Fringe,
    GrayBit,
    NoiseModel,
    Pattern,
    PatternPlan,
    TablePosition,
    Uniform,
)

FORMAT: Literal["fringe3d-scan/1"] = "fringe3d-scan/1"


class CameraTable(StrictModel):
    """One camera: its name in the rig and the files of its images.

    ``images`` is a path with ``{index}`` (or ``{index:02d}``) for the number of the image and
    ``*`` for anything; or `files` lists the files one by one; or `stack` is one ``.npy`` file.
    """

    name: str
    images: str | None = None
    files: list[str] | None = None
    stack: str | None = None
    first_index: int = 0
    channel: Channel = "grey"

    @model_validator(mode="after")
    def _one_kind_of_files(self) -> CameraTable:
        if sum(kind is not None for kind in (self.images, self.files, self.stack)) != 1:
            raise ValueError(
                "expected one of images (a pattern), files (a list) and stack (a .npy file)"
            )
        if self.stack is not None and not self.stack.endswith(".npy"):
            raise ValueError(f"stack: expected the name of a .npy file, found '{self.stack}'")
        if self.images is not None:
            try:
                differs = self.images.format(index=0) != self.images.format(index=1)
            except (KeyError, ValueError, IndexError):
                differs = False
            if not differs:
                raise ValueError("images: expected a path with {index} or {index:02d} in it")
        return self

    @property
    def first_file(self) -> str:
        """Return the path of the first file, or its pattern."""
        return self.stack or (self.files[0] if self.files else self.images or "")


class NoiseTable(StrictModel):
    """Noise of a grey value: ``read_noise_dn**2 + gain_dn_per_e * signal``."""

    read_noise_dn: float = Field(ge=0)
    gain_dn_per_e: float = Field(default=0.0, ge=0)

    def model(self) -> NoiseModel:
        """Return the noise model."""
        return NoiseModel(read_noise_dn=self.read_noise_dn, gain_dn_per_e=self.gain_dn_per_e)


class PositionTable(StrictModel):
    """Where a rotary table stood."""

    angle_deg: float | None = None
    tilt_deg: float = 0.0

    def position(self) -> TablePosition:
        """Return the position, in rad."""
        angle = None if self.angle_deg is None else math.radians(self.angle_deg)
        return TablePosition(angle=angle, tilt=math.radians(self.tilt_deg))


class PlanTable(StrictModel):
    """``plan.toml``: the sequence alone."""

    format: Literal["fringe3d-scan/1"]
    title: str = ""
    projector_size: tuple[PositiveInt, PositiveInt] | None = None
    sequence: Annotated[list[SequenceTable], Field(min_length=1)]

    def plan(self) -> PatternPlan:
        """Return the plan."""
        shape = self.projector_size[::-1] if self.projector_size else None
        return PatternPlan(
            patterns=tuple(p for table in self.sequence for p in table.patterns()),
            projector_shape=shape,
        )


class ScanTable(PlanTable):
    """``scan.toml``: the sequence and the images."""

    rig: str | None = None
    response: str | None = None
    folder: str = ""
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 8
    black_level_dn: Annotated[float, Field(ge=0)] = 0.0
    saturation_dn: PositiveFloat | None = None
    exposure_ms: PositiveFloat | None = None
    exposures: list[PositiveFloat] | None = None
    extra_images: Literal["error", "ignore"] = "error"
    image_indices: list[int] | None = None
    noise: NoiseTable | None = None
    table: PositionTable | None = None
    cameras: Annotated[list[CameraTable], Field(min_length=1)]

    @property
    def saturation(self) -> float:
        """Return the grey value from which on pixels are saturated, DN."""
        top = float(2**self.bit_depth - 1)
        return top if self.saturation_dn is None else self.saturation_dn

    @property
    def noise_model(self) -> NoiseModel | None:
        """Return the noise of a grey value, where it is known."""
        return self.noise.model() if self.noise else None

    @property
    def n_recorded(self) -> int:
        """Return the number of images of each camera: the sequence, once for each exposure."""
        return self.plan().n_images * len(self.exposures or [1.0])

    @model_validator(mode="after")
    def _grey_values_in_order(self) -> ScanTable:
        top = 2**self.bit_depth - 1
        if not self.black_level_dn < self.saturation <= top:
            raise ValueError(
                f"expected black_level_dn < saturation_dn <= {top} (bit_depth = {self.bit_depth}), "
                f"found {self.black_level_dn:g} and {self.saturation:g}"
            )
        return self


def read_scan_table(path: Path, /) -> ScanTable:
    """Read and check a scan file."""
    table = read_toml(path, ScanTable, PlanError)
    _require_plan(path, table)
    n_images = table.n_recorded
    if table.image_indices is not None and len(table.image_indices) != n_images:
        raise PlanError(
            f"{path}: image_indices: expected {n_images} numbers, one for each pattern of the "
            f"sequence, found {len(table.image_indices)}. Correct one of them"
        )
    repeated = sorted(n for n, times in Counter(table.image_indices).items() if times > 1)
    if repeated:
        raise PlanError(
            f"{path}: image_indices: expected a different image for each pattern, found "
            f"{', '.join(map(str, repeated))} more than once. Correct the list"
        )
    for camera in table.cameras:
        if camera.files is not None and len(camera.files) != n_images:
            raise PlanError(
                f"{path}: camera '{camera.name}': the sequence lists {n_images} patterns, but "
                f"files lists {len(camera.files)}. Correct one of them"
            )
    names = [camera.name for camera in table.cameras]
    if len(set(names)) < len(names):
        raise PlanError(f"{path}: cameras: expected different names, found {names}. Rename one")
    return table


def read_plan(path: Path, /) -> PatternPlan:
    """Read ``plan.toml`` (or the plan of a scan file)."""
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if "[[cameras]]" in text:
        return read_scan_table(path).plan()
    table = read_toml(path, PlanTable, PlanError)
    _require_plan(path, table)
    return table.plan()


def _require_plan(path: Path, table: PlanTable) -> None:
    for number, entry in enumerate(table.sequence):
        try:
            entry.patterns()
        except ValueError as problem:
            raise PlanError(f"{path}: sequence[{number}]: {problem}. Correct it") from None
    try:
        table.plan()
    except ValueError as problem:
        raise PlanError(f"{path}: {problem}. Correct the sequence") from None


def plan_text(plan: PatternPlan, /, *, title: str = "") -> str:
    """Return the text of the plan file that `read_plan` reads back."""
    table = PlanTable(
        format=FORMAT,
        title=title,
        projector_size=plan.projector_shape[::-1] if plan.projector_shape else None,
        sequence=sequence_tables(plan),
    )
    return toml_text(table)


def toml_text(table: PlanTable, /) -> str:
    """Return a scan or plan table as TOML; defaults are left out."""
    return tomlkit.dumps(table.model_dump(exclude_defaults=True, exclude_none=True))


def sequence_tables(plan: PatternPlan, /) -> list[SequenceTable]:
    """Describe a plan by few ``[[sequence]]`` entries: one for each regular set of images."""
    runs = [list(run) for _, run in itertools.groupby(plan.patterns, key=_belongs_to)]
    return [table for run in runs for table in _tables(run)]


def _belongs_to(pattern: Pattern) -> tuple[object, ...]:
    match pattern:
        case Fringe():
            return "fringes", pattern.period_px, pattern.angle
        case GrayBit():
            return "gray", pattern.cell_px, pattern.angle, pattern.n_bits, pattern.first_cell
        case Uniform():
            return ("uniform",)
        case _:
            return ("unused",)


def _tables(run: list[Pattern]) -> list[SequenceTable]:
    """Return the first description that yields the run again; else one for each image."""
    candidates: list[SequenceTable]
    match run[0]:
        case Fringe() as first:
            candidates = _fringe_tables(first, [p.shift for p in run if isinstance(p, Fringe)])
        case GrayBit() as first:
            candidates = _gray_tables(first, [p for p in run if isinstance(p, GrayBit)])
        case Uniform(level=level):
            candidates = [LightTable(kind="light") if level else DarkTable(kind="dark")]
            if not all(isinstance(p, Uniform) and p.level in (0, 1) for p in run):
                candidates = [_ramp_table(run)]
        case _:
            candidates = [UnusedTable(kind="unused", count=len(run))]
    whole = [table for table in candidates if _same(table.patterns(), run)]
    return whole[:1] or [table for pattern in run for table in _tables([pattern])]


def _ramp_table(run: list[Pattern]) -> RampTable:
    return RampTable(kind="ramp", levels=[p.level for p in run if isinstance(p, Uniform)])


def _fringe_tables(first: Fringe, shifts: list[float]) -> list[SequenceTable]:
    common = FringesTable(
        kind="fringes",
        period_px=first.period_px,
        shifts_deg=[math.degrees(shift) for shift in shifts],
        **_direction(first.angle),
    )
    if len(shifts) < 3:
        return [common]
    equal = {"shifts_deg": None, "n_shifts": len(shifts)}
    return [
        common.model_copy(update=equal),
        common.model_copy(update=equal | {"shift_direction": -1}),
        common,
    ]


def _gray_tables(first: GrayBit, run: list[GrayBit]) -> list[SequenceTable]:
    bits = list(dict.fromkeys(pattern.bit for pattern in run))
    common = GrayTable(
        kind="gray",
        cell_px=first.cell_px,
        n_bits=first.n_bits,
        first_cell=first.first_cell,
        bits=None if bits == list(range(first.n_bits))[::-1] else bits,
        **_direction(first.angle),
    )
    return [
        common.model_copy(update={"inverses": inverses, "bright_is": bright_is})
        for bright_is in (1, 0)
        for inverses in ("none", "interleaved", "after")
    ]


def _direction(angle: float) -> dict[str, Any]:
    if angle in (0.0, math.pi / 2):
        return {"direction": "y" if angle else "x"}
    return {"angle_deg": math.degrees(angle)}


def _same(a: list[Pattern], b: list[Pattern]) -> bool:
    """Tell whether two runs are the same, up to the rounding of degrees."""

    def key(pattern: Pattern) -> tuple[object, ...]:
        shift = round(pattern.shift, 9) if isinstance(pattern, Fringe) else 0.0
        return (*_belongs_to(pattern)[:2], shift, getattr(pattern, "level", None),
                getattr(pattern, "bit", None), getattr(pattern, "inverted", None))  # fmt: skip

    return [key(p) for p in a] == [key(p) for p in b]
