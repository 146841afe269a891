"""Descriptions of recordings made by other software."""

from __future__ import annotations

import math
import os
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
from pydantic import ValidationError

from fringe3d.errors import Fringe3DError, ImageError, PlanError, RigError
from fringe3d.io.images import read_image
from fringe3d.io.opencv_calibration import KNOWN_KEYS, CalibrationKeys, read_opencv_calibration
from fringe3d.io.recording import image_size
from fringe3d.io.scanfile import FORMAT, ScanTable, toml_text
from fringe3d.io.sequencefile import (
    DarkTable,
    FringesTable,
    GrayTable,
    LightTable,
    RampTable,
    UnusedTable,
)
from fringe3d.io.toml import first_problem
from fringe3d.model import Rig

IMAGE_SUFFIXES = {".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg"}

BIT_DEPTHS = (10, 12, 14, 16)
"""Of cameras that need 16-bit files."""

Kind = FringesTable | GrayTable | LightTable | DarkTable | RampTable | UnusedTable

KINDS: dict[str, type[Kind]] = {
    "fringes": FringesTable,
    "gray": GrayTable,
    "light": LightTable,
    "dark": DarkTable,
    "ramp": RampTable,
    "unused": UnusedTable,
}

INDEX = r"\{index(?::(\d{0,2}d?))?\}"
"""The number of an image in a pattern, with its format."""


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
                f"n_shifts=4', found '{word}'. Correct it"
            )
        if key in entry:
            raise PlanError(f"--sequence '{text}': expected '{key}' once, found it again. Drop one")
        entry[key] = _value(text, key, value)
    _table(text, entry)
    return entry


def count_images(sequence: Iterable[str], /) -> int:
    """Return how many images the entries describe.

    Examples
    --------
    >>> count_images(["fringes period_px=60 n_shifts=12", "gray cell_px=30 n_bits=6", "light"])
    19
    """
    return sum(len(_table(text, parse_sequence(text)).patterns()) for text in sequence)


def _table(text: str, entry: dict[str, Any]) -> Kind:
    schema = KINDS.get(entry["kind"])
    if schema is None:
        raise PlanError(
            f"--sequence '{text}': expected one of the kinds {', '.join(KINDS)}, "
            f"found '{entry['kind']}'. Correct it"
        )
    try:
        table = schema.model_validate(entry)
    except ValidationError as problem:
        raise PlanError(f"--sequence '{text}': {first_problem(problem, schema, entry)}") from None
    try:
        table.patterns()
    except ValueError as problem:
        raise PlanError(f"--sequence '{text}': {problem}. Correct it") from None
    return table


def _value(sequence: str, key: str, text: str) -> int | float | str | list[float]:
    if key in ("bits", "shifts_deg"):
        try:
            return [float(part) for part in text.split(",")]
        except ValueError:
            raise PlanError(
                f"--sequence '{sequence}': {key}: expected numbers with commas between, "
                f"found '{text}'. Correct it"
            ) from None
    if re.fullmatch(r"[-+]?\d{1,9}", text) and not key.endswith(("_px", "_deg", "_coordinate")):
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
            f"--camera: expected NAME=PATTERN, as c1=left/{{index:02d}}.png, found '{text}'. "
            "Correct it"
        )
    # An @ within the pattern is part of a name.
    parts = re.fullmatch(r"(.*)@([^@{}/]*)", pattern)
    entry: dict[str, Any] = {"name": name, "images": parts[1] if parts else pattern}
    if not re.search(INDEX, entry["images"]) or re.search(
        r"[{}]", re.sub(INDEX, "", entry["images"])
    ):
        raise PlanError(
            f"--camera '{text}': expected a path with {{index}} or {{index:02d}} for the number "
            f"of the image, found '{entry['images']}'. Correct it"
        )
    if parts and not re.fullmatch(r"\d{1,9}", parts[2], re.ASCII):
        raise PlanError(
            f"--camera '{text}': expected a whole number, that of the first image, behind the @, "
            f"found '{parts[2]}'. Correct it"
        )
    if parts:
        entry["first_index"] = int(parts[2])
    return entry


def parse_size(text: str, /, option: str = "--projector-size") -> tuple[int, int]:
    """Return (width, height) from ``1024x768``."""
    match = re.fullmatch(r"\s*(\d{1,6})\s*x\s*(\d{1,6})\s*", text.lower())
    if match is None or 0 in (int(match[1]), int(match[2])):
        raise PlanError(
            f"{option}: expected WIDTHxHEIGHT in pixels, as 1024x768, found '{text}'. Correct it"
        )
    return int(match[1]), int(match[2])


def parse_depth(text: str, /) -> tuple[float, float]:
    """Return the depth range (from, to), mm, from ``MIN:MAX``."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = math.nan
    if not (-math.inf < low < high < math.inf and high > 0):
        raise PlanError(
            "--depth: expected MIN:MAX in mm, finite, MIN below MAX and MAX above 0, as 600:800, "
            f"found '{text}'. Correct it"
        )
    return low, high


def parse_keys(text: str, /) -> CalibrationKeys:
    """Return the names of matrices from ``M1,D1,M2,D2,R,T``, with ``:projector`` or without.

    Examples
    --------
    >>> parse_keys("K1,k1,Kp,kp,R,T:projector").second_role
    'projector'
    """
    names, _, role = text.partition(":")
    parts = [part.strip() for part in names.split(",")]
    if len(parts) != 6 or not all(parts) or role.strip() not in ("", "camera", "projector"):
        raise PlanError(
            "--calibration-keys: expected M1,D1,M2,D2,R,T and optionally :projector, "
            f"found '{text}'. Correct it"
        )
    matrix1, distortion1, matrix2, distortion2, rotation, translation = parts
    return CalibrationKeys(
        matrix1=matrix1,
        distortion1=distortion1,
        matrix2=matrix2,
        distortion2=distortion2,
        rotation=rotation,
        translation=translation,
        second_role="projector" if role.strip() == "projector" else "camera",
    )


def parse_bit_depth(text: str, /, *, file_bits: int = 16, brightest: int = 0) -> int:
    """Return the bits of a grey value that fits files with that many bits and that grey value."""
    low, high = max(8, brightest.bit_length()), file_bits
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII) or not low <= int(text) <= high:
        wanted = f"{low} to {high}" if low < high else f"{low}"
        reason = f" (the brightest grey value is {brightest})" if low < high and brightest else ""
        raise PlanError(f"--bit-depth: expected {wanted}{reason}, found '{text}'. Correct it")
    return int(text)


def propose_bit_depth(file_bits: int, brightest: int, /) -> int:
    """Return the likely bits of a grey value, from the bits of the files and the brightest one.

    Examples
    --------
    >>> propose_bit_depth(16, 4095)
    12
    """
    if file_bits == 8:
        return 8
    return next(bits for bits in BIT_DEPTHS if brightest < 2**bits)


def grey_values(images: Path, cameras: Sequence[dict[str, Any]], /) -> tuple[int, int]:
    """Return the bits of the image files, and the brightest grey value in them."""
    files = [file for camera in cameras for file in image_files(images, camera).values()]
    file_bits, brightest = 8, 0
    for file in files:
        # What cannot be read is for the check to say, when all is described.
        with suppress(ImageError):
            image = read_image(file)
            file_bits = max(file_bits, 8 * image.dtype.itemsize)
            brightest = max(brightest, int(image.max()))
            if file_bits == 8:
                return 8, 255
    return file_bits, brightest


def image_files(images: Path, camera: dict[str, Any], /) -> dict[int, Path]:
    """Return the image files of a ``[[cameras]]`` entry by their numbers."""
    pattern = PurePosixPath(camera["images"])
    folder = images / pattern.parent
    spec = re.search(INDEX, pattern.name)
    if spec is None or not folder.is_dir():
        return {}
    pieces = re.split(r"(\{index[^}]*\}|\*)", pattern.name)
    wanted = re.compile(
        "".join(
            r"(\d+)" if piece.startswith("{") else ".*" if piece == "*" else re.escape(piece)
            for piece in pieces
        ),
        re.ASCII,
    )
    matches = [match for p in sorted(folder.iterdir()) if (match := wanted.fullmatch(p.name))]
    return {
        int(match[1]): folder / match[0]
        for match in matches
        if format(int(match[1]), spec[1] or "") == match[1]
    }


def require_images(images: Path, camera: dict[str, Any], /) -> tuple[int, int]:
    """Return (width, height) of a camera's first image; refuse a pattern that finds none."""
    where = f"--camera '{camera['name']}={camera['images']}'"
    numbers = sorted(image_files(images, camera))
    if not numbers:
        raise ImageError(
            f"{where}: expected images of this pattern in {images}, found none. Correct the pattern"
        )
    first = camera.get("first_index", 0)
    if first not in numbers:
        raise ImageError(
            f"{where}: expected image {first} to be the first, found the numbers {numbers[0]} to "
            f"{numbers[-1]}. Give the first as {camera['name']}={camera['images']}@{numbers[0]}"
        )
    return image_size(images, camera)


def guess_cameras(folder: Path, /) -> list[str]:
    """Propose ``NAME=PATTERN@FIRST`` for every set of numbered images, by name."""
    proposals: list[str] = []
    for place in [folder, *sorted(p for p in folder.iterdir() if p.is_dir())]:
        inside = "" if place == folder else f"{place.name}/"
        for pattern in _numbered_patterns(place):
            proposals.append(f"c{len(proposals) + 1}={inside}{pattern}")
    return proposals


def _numbered_patterns(folder: Path) -> list[str]:
    """Return the patterns of the largest sets of numbered images: two cameras have as many."""
    found: dict[tuple[str, str], list[str]] = defaultdict(list)
    for path in sorted(folder.iterdir()):
        match = re.fullmatch(r"([^{}*]*?)(\d+)(\.\w+)", path.name, re.ASCII)
        if match and match[3].lower() in IMAGE_SUFFIXES:
            found[match[1], match[3]].append(match[2])
    most = max(map(len, found.values()), default=0)
    return [
        f"{head}{_index(digits)}{tail}@{min(map(int, digits))}"
        for (head, tail), digits in found.items()
        if len(digits) == most
    ]


def _index(digits: list[str]) -> str:
    """Return how the numbers are written: 00 ... 09 show their width, 10 ... do not."""
    width = max((len(d) for d in digits if d.startswith("0") and len(d) > 1), default=0)
    return f"{{index:0{width}d}}" if width else "{index}"


def has_known_keys(path: Path, /) -> bool:
    """Tell whether a file of OpenCV holds one of the known sets of matrices.

    Raises
    ------
    RigError
        If there is no such file, or it is none of OpenCV's.
    """
    return any(
        {keys.matrix1, keys.distortion1, keys.matrix2, keys.distortion2,
         keys.rotation, keys.translation} <= set(matrix_names(path))
        for keys in KNOWN_KEYS
    )  # fmt: skip


def matrix_names(path: Path, /) -> list[str]:
    """Return the names of the entries in a file of OpenCV's FileStorage."""
    if not path.is_file():
        raise RigError(f"{path}: expected a calibration file, found none. Check the path")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        names = storage.root().keys()
    except (cv2.error, SystemError):
        raise RigError(
            f"{path}: expected OpenCV YAML, XML or JSON, found something else. Check the file"
        ) from None
    return sorted(names)


def read_calibration(
    path: Path,
    /,
    *,
    images: Path,
    cameras: Sequence[dict[str, Any]],
    projector_size: tuple[int, int] | None,
    keys: CalibrationKeys | None,
    inverse_pose: bool,
) -> Rig:
    """Read the rig of a recording from a calibration by OpenCV; its problems are `RigError`."""
    try:
        return read_opencv_calibration(
            path,
            camera_sizes=[require_images(images, camera) for camera in cameras],
            projector_size=projector_size,
            keys=keys,
            second_from_first=not inverse_pose,
            camera_names=[camera["name"] for camera in cameras],
        )
    except Fringe3DError:
        raise
    except cv2.error:
        problem = "expected matrices, found an entry of another kind"
    except ValueError as error:
        problem = str(error)
    raise RigError(f"{path}: {problem}. Check the file, and the names of its matrices")


def relative_path(path: Path, /, *, to: Path) -> str:
    """Return a path as a file in the folder `to` names it; whole if it lies on another drive."""
    try:
        return Path(os.path.relpath(path.resolve(), to.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def scan_text(entries: dict[str, Any], /, *, images: Path, out: Path) -> str:
    """Return the text of a scan file at `out` for images in the folder `images`.

    Raises
    ------
    PlanError
        If an entry does not fit the format; says which.
    """
    names = [camera["name"] for camera in entries["cameras"]]
    if len(set(names)) < len(names):
        raise PlanError(f"--camera: expected different names, found {', '.join(names)}. Rename one")
    folder = relative_path(images, to=out.parent)
    table = {"format": FORMAT, **entries, "folder": "" if folder == "." else folder}
    try:
        return toml_text(ScanTable.model_validate(table))
    except ValidationError as problem:
        raise PlanError(f"{out}: {first_problem(problem, ScanTable, table)}") from None
