"""Image files to grey-value arrays, and back."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from fringe3d.errors import ImageError

Channel = Literal["grey", "red", "green", "blue"]
Grey = NDArray[np.unsignedinteger[Any]]


def read_image(path: Path, /, *, channel: Channel = "grey") -> Grey:
    """Read an 8- or 16-bit image (PNG, TIFF, BMP, JPEG) as grey values (row, col).

    Raises
    ------
    ImageError
        If the file is missing, is not an image, is cut off, or has another sample type.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ImageError(f"{path}: expected an image, found no such file") from None
    except OSError as problem:
        raise ImageError(f"{path}: cannot be read: {problem}") from None
    _require_complete(path, data)
    image = _decode(path, data)
    if image.dtype not in (np.uint8, np.uint16):
        raise ImageError(
            f"{path}: expected samples of 8 or 16 bit, found {image.dtype}. Convert the image"
        )
    return _to_grey(path, image, channel)


def _require_complete(path: Path, data: bytes) -> None:
    """Refuse files that a decoder would fill up with grey without a word."""
    cut_off = not data
    if data.startswith(b"\x89PNG"):
        cut_off = b"IEND" not in data[-64:]
    elif data.startswith(b"\xff\xd8"):
        cut_off = data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda")
    elif data.startswith(b"BM"):
        cut_off = len(data) < int.from_bytes(data[2:6], "little")
    if cut_off:
        raise ImageError(
            f"{path}: expected a complete image, found one that is cut off after "
            f"{len(data)} bytes. Copy the file again"
        )


def _decode(path: Path, data: bytes) -> NDArray[Any]:
    unreadable = f"{path}: expected a PNG, TIFF, BMP or JPEG image, found a file that cannot be "
    if data[:4] in (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+"):
        try:
            return np.asarray(tifffile.imread(io.BytesIO(data)))
        except Exception as problem:  # noqa: BLE001  (tifffile raises many kinds)
            image = _decode_tiff_by_opencv(data)  # knows LZW
            if image is None:
                raise ImageError(f"{unreadable}decoded: {problem}. Copy it again") from None
            return image
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as problem:
        raise ImageError(f"{unreadable}decoded: {problem}") from None
    if image is None:
        raise ImageError(f"{unreadable}decoded. Check the file")
    return np.asarray(image)


def _decode_tiff_by_opencv(data: bytes) -> NDArray[Any] | None:
    """Return a TIFF in the channel order of TIFF files, None if it cannot be decoded."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    if image is None:
        return None
    return np.asarray(image[..., ::-1] if image.ndim == 3 else image)


def _to_grey(path: Path, image: NDArray[Any], channel: Channel) -> Grey:
    if image.ndim == 2:
        return image
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4):
        raise ImageError(
            f"{path}: expected one grey or three colour channels, found shape {image.shape}. "
            "Convert the image"
        )
    if image.shape[2] == 1:
        return image[..., 0]
    red_first = path.suffix.lower() in (".tif", ".tiff")
    bgr = image[..., 2::-1] if red_first else image[..., :3]
    if channel == "grey":
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(bgr), cv2.COLOR_BGR2GRAY))
    return np.ascontiguousarray(bgr[..., ("blue", "green", "red").index(channel)])


def write_png(path: Path, image: NDArray[Any], /) -> None:
    """Write an 8- or 16-bit grey or colour (RGB) image as PNG."""
    pixels = image[..., ::-1] if image.ndim == 3 else image
    coded, data = cv2.imencode(".png", np.ascontiguousarray(pixels))
    if not coded:
        raise ImageError(f"{path}: an array of {image.dtype} {image.shape} is not an image")
    path.write_bytes(data.tobytes())
