"""Descriptions of recordings made by other software."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fringe3d.errors import PlanError
from fringe3d.io.scanfile import FORMAT, ScanTable, toml_text
from fringe3d.io.toml import first_problem

IMAGE_SUFFIXES = {".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg"}


def parse_sequence(text: str, /) -> dict[str, Any]:
    """Return one ``[[sequence]]`` entry from words like ``fringes period_px=60 n_shifts=12``.

    Examples
    --------
    >>> parse_sequence("gray cell_px=30 n_bits=6 inverses=interleaved")
    {'kind': 'gray', 'cell_px': 30.0, 'n_bits': 6, 'inverses': 'interleaved'}
    """
    kind, *words = text.split() or [""]
    entry: dict[str, Any] = {"kind": kind}
    for word in words:
        key, equals, value = word.partition("=")
        if not (key and equals and value):
            raise PlanError(
                f"--sequence '{text}': expected KIND KEY=VALUE ..., as 'fringes period_px=16 "
                f"n_shifts=4', found '{word}'"
            )
        entry[key] = _value(key, value)
    return entry


def _value(key: str, text: str) -> int | float | str | list[float]:
    if "," in text:
        try:
            return [float(part) for part in text.split(",")]
        except ValueError:
            raise PlanError(
                f"--sequence: {key}: expected numbers with commas between, found '{text}'. "
                "Correct it"
            ) from None
    if re.fullmatch(r"[-+]?\d+", text) and not key.endswith(("_px", "_deg", "_coordinate")):
        return int(text)
    try:
        return float(text)
    except ValueError:
        return text


def parse_camera(text: str, /) -> dict[str, Any]:
    """Return one ``[[cameras]]`` entry from ``NAME=PATTERN`` or ``NAME=PATTERN@FIRST``.

    Examples
    --------
    >>> parse_camera("c1=left/{index:02d}.png@1")
    {'name': 'c1', 'images': 'left/{index:02d}.png', 'first_index': 1}
    """
    name, equals, pattern = text.partition("=")
    if not (name and equals and pattern):
        raise PlanError(
            f"--camera: expected NAME=PATTERN, as c1=left/{{index:02d}}.png, found '{text}'"
        )
    pattern, _, first = pattern.partition("@")
    entry: dict[str, Any] = {"name": name, "images": pattern}
    if first:
        entry["first_index"] = int(first) if first.isdigit() else first
    return entry


def guess_cameras(folder: Path, /) -> list[str]:
    """Propose ``NAME=PATTERN@FIRST`` for every folder with numbered images, by name."""
    proposals: list[str] = []
    for place in [folder, *sorted(p for p in folder.iterdir() if p.is_dir())]:
        pattern = _numbered_pattern(place)
        if pattern is not None:
            inside = "" if place == folder else f"{place.name}/"
            proposals.append(f"c{len(proposals) + 1}={inside}{pattern}")
    return proposals


def _numbered_pattern(folder: Path) -> str | None:
    """Return the pattern that most of the numbered images of a folder follow."""
    found: dict[tuple[str, str, int], list[int]] = defaultdict(list)
    for path in folder.iterdir():
        match = re.fullmatch(r"(.*?)(\d+)(\.\w+)", path.name)
        if match and match[3].lower() in IMAGE_SUFFIXES:
            width = len(match[2]) if match[2].startswith("0") and len(match[2]) > 1 else 0
            found[match[1], match[3], width].append(int(match[2]))
    if not found:
        return None
    widest = max(width for _, _, width in found)
    # 00 ... 09 show their width, 10 ... do not: both belong to the padded pattern.
    groups: dict[tuple[str, str], list[int]] = defaultdict(list)
    for (head, tail, _), numbers in found.items():
        groups[head, tail] += numbers
    (head, tail), numbers = max(groups.items(), key=lambda item: len(item[1]))
    index = f"{{index:0{widest}d}}" if widest else "{index}"
    return f"{head}{index}{tail}@{min(numbers)}"


def scan_text(entries: dict[str, Any], /, *, images: Path, out: Path) -> str:
    """Return the text of a scan file at `out` for images in the folder `images`.

    Raises
    ------
    PlanError
        If an entry does not fit the format; says which.
    """
    folder = Path(os.path.relpath(images.resolve(), out.resolve().parent)).as_posix()
    table = {"format": FORMAT, **entries, "folder": "" if folder == "." else folder}
    try:
        return toml_text(ScanTable.model_validate(table))
    except ValidationError as problem:
        raise PlanError(f"{out}: {first_problem(problem, ScanTable, table)}") from None
