"""Scan folders as the product writes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from fringe3d.io.images import write_png
from fringe3d.io.rigfile import rig_text
from fringe3d.io.scanfile import (
    FORMAT,
    CameraTable,
    NoiseTable,
    PositionTable,
    ScanTable,
    sequence_tables,
    toml_text,
)
from fringe3d.model import Scan, TablePosition

DEGREE_DIGITS = 9
"""Of angles in files: 2e-11 rad."""


def write_scan(
    folder: Path,
    scan: Scan,
    /,
    *,
    series: Sequence[Scan] = (),
    exposures: Sequence[float] = (),
    exposure_ms: float | None = None,
) -> None:
    """Write ``scan.toml``, ``rig.toml`` and the images of every camera into a folder.

    `series` are the same with other exposures; `exposures` tells the amount of light of all,
    `exposure_ms` the time of one, where it is known and the same for all cameras.
    """
    first = scan.stacks[0]
    bits = 8 * first.images.dtype.itemsize
    shape = first.plan.projector_shape
    has_projector = scan.rig is not None and scan.rig.projector is not None
    table = ScanTable(
        format=FORMAT,
        title=scan.title,
        rig="rig.toml" if scan.rig else None,
        projector_size=shape[::-1] if shape and not has_projector else None,
        bit_depth=bits,
        black_level_dn=first.black_level_dn,
        saturation_dn=None if first.saturation_dn == 2**bits - 1 else first.saturation_dn,
        noise=NoiseTable(
            read_noise_dn=first.noise.read_noise_dn, gain_dn_per_e=first.noise.gain_dn_per_e
        )
        if first.noise
        else None,
        table=_position(scan.table),
        exposure_ms=exposure_ms,
        exposures=list(exposures) or None,
        cameras=[
            CameraTable(name=stack.device_name, images=f"{stack.device_name}/{{index:03d}}.png")
            for stack in scan.stacks
        ],
        sequence=sequence_tables(first.plan),
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scan.toml").write_text(toml_text(table), encoding="utf-8")
    if scan.rig is not None:
        (folder / "rig.toml").write_text(rig_text(scan.rig), encoding="utf-8")
    for stacks in zip(scan.stacks, *(other.stacks for other in series), strict=True):
        place = folder / stacks[0].device_name
        place.mkdir(exist_ok=True)
        for index, image in enumerate(chain.from_iterable(stack.images for stack in stacks)):
            write_png(place / f"{index:03d}.png", image)


def _position(table: TablePosition | None) -> PositionTable | None:
    if table is None:
        return None
    angle = None if table.angle is None else round(math.degrees(table.angle), DEGREE_DIGITS)
    return PositionTable(angle_deg=angle, tilt_deg=round(math.degrees(table.tilt), DEGREE_DIGITS))
