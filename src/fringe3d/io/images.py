"""Image files to grey-value arrays, and back."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from fringe3d.errors import ImageError

MAX_THREADS = 8

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


def read_images(
    files: Sequence[Path], /, *, channel: Channel = "grey", done: Callable[[int], None]
) -> Grey:
    """Read image files of one camera in threads, (pattern, row, col).

    Beside the result, each thread holds one image. `done` gets the number of images read.

    Raises
    ------
    ImageError
        For the first file that cannot be read, or differs from the first in size or type.
    """
    first = read_image(files[0], channel=channel)
    images = np.empty((len(files), *first.shape), first.dtype)

    def read(number: int) -> None:
        picture = first if number == 0 else read_image(files[number], channel=channel)
        _require_alike(files[number], picture, files[0], first)
        images[number] = picture

    with ThreadPoolExecutor(min(os.cpu_count() or 1, MAX_THREADS)) as pool:
        for number, _ in enumerate(pool.map(read, range(len(files)))):
            done(number + 1)
    return images


def _require_alike(file: Path, picture: Grey, first_file: Path, first: Grey) -> None:
    if picture.shape != first.shape:
        raise ImageError(
            f"{file}: expected {_size(first)} pixels as in {first_file.name}, "
            f"found {_size(picture)}. Is it an image of another camera?"
        )
    if picture.dtype != first.dtype:
        raise ImageError(
            f"{file}: expected {first.dtype.itemsize * 8} bit as in {first_file.name}, "
            f"found {picture.dtype.itemsize * 8} bit. Convert one of them"
        )


def _size(image: Grey) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


def read_stack(path: Path, /) -> Grey:
    """Map a ``.npy`` file of images (pattern, row, col) into memory, without reading them.

    Raises
    ------
    ImageError
        If it is no ``.npy`` file, is cut off, or holds anything but images of 8 or 16 bit.
    """
    try:
        images = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise ImageError(f"{path}: expected a stack of images, found no such file") from None
    except (OSError, ValueError, EOFError) as problem:
        raise ImageError(
            f"{path}: expected a complete .npy file, found one that cannot be read: {problem}. "
            "Write it again with numpy.save"
        ) from None
    if not isinstance(images, np.ndarray) or images.ndim != 3 or images.size == 0:
        found = f"shape {images.shape}" if isinstance(images, np.ndarray) else "an archive"
        raise ImageError(f"{path}: expected a stack of images (pattern, row, col), found {found}")
    if images.dtype not in (np.uint8, np.uint16):
        raise ImageError(
            f"{path}: expected samples of 8 or 16 bit (uint8, uint16), found {images.dtype.str}. "
            "Convert the stack"
        )
    return np.asarray(images)


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
