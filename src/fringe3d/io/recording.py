"""Scan folders and scan files to `Scan`: finding, counting and reading the images."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import numpy as np

from fringe3d.errors import ImageError, PlanError, RigError
from fringe3d.io.images import Grey, read_image
from fringe3d.io.rigfile import read_rig
from fringe3d.io.scanfile import CameraTable, ScanTable, read_scan_table
from fringe3d.model import ImageStack, PatternPlan, Rig, Scan

LOSSY_SUFFIXES = {".jpg", ".jpeg"}

Progress = Callable[[str, int, int], None]
"""Called with the name of the work, the steps done and the steps there are."""


def _silent(_work: str, _done: int, _total: int) -> None:
    pass


def read_scan(
    path: Path,
    /,
    *,
    images: Path | None = None,
    rig: Path | None = None,
    progress: Progress = _silent,
) -> Scan:
    """Read a scan folder, or the scan file of a recording that lies elsewhere.

    Parameters
    ----------
    path : folder with a ``scan.toml``, or a scan file
    images : folder of the images; that of the scan file if None
    rig : rig file that replaces the one named in the scan file
    progress : called as the images are read

    Raises
    ------
    PlanError, ImageError, RigError
    """
    if not path.exists():
        raise PlanError(
            f"{path}: expected a scan folder or a scan file, found neither. Check the path"
        )
    file = path / "scan.toml" if path.is_dir() else path
    if path.is_dir() and not file.is_file():
        raise PlanError(
            f"{path}: expected a scan folder with a scan.toml, found none. "
            "Describe the recording with 'fringe3d import', or name the scan file"
        )
    table = read_scan_table(file)
    rig_file = rig or (file.parent / table.rig if table.rig else None)
    the_rig = read_rig(rig_file) if rig_file else None
    plan = _plan(file, table, the_rig)
    _require_images(file, table, images)
    listed = [
        _image_files(table, camera, _base_folder(file, table, camera, images), plan.n_images)
        for camera in table.cameras
    ]
    total = sum(len(files) for files in listed)
    stacks: list[ImageStack] = []
    for camera, files in zip(table.cameras, listed, strict=True):
        done = sum(len(stack.images) for stack in stacks)
        pictures = []
        for number, image_file in enumerate(files):
            pictures.append(read_image(image_file, channel=camera.channel))
            progress("reading images", done + number + 1, total)
        stacks.append(_stack(table, camera, files, pictures, plan))
    scan = Scan(stacks=tuple(stacks), rig=the_rig, title=table.title)
    _require_fit(scan, rig_file)
    return scan


def _plan(file: Path, table: ScanTable, rig: Rig | None) -> PatternPlan:
    plan = table.plan()
    if rig is None or rig.projector is None:
        return plan
    if plan.projector_shape not in (None, rig.projector.shape):
        raise PlanError(
            f"{file}: projector_size: the rig's projector '{rig.projector.name}' has "
            f"{rig.projector.n_cols} x {rig.projector.n_rows} pixels, found "
            f"{list(table.projector_size or ())}. Correct one of them"
        )
    return PatternPlan(patterns=plan.patterns, projector_shape=rig.projector.shape)


def _require_images(file: Path, table: ScanTable, images: Path | None) -> None:
    """Refuse a folder that is none, or that holds no image of any camera."""
    if images is not None and not images.is_dir():
        found = "a file" if images.exists() else "none"
        raise ImageError(
            f"--images {images}: expected the folder of the images, found {found}. Name the "
            "folder of the recording, or one above it"
        )
    for camera in table.cameras:
        if _matches(_base_folder(file, table, camera, images), camera, None):
            return
    first = table.cameras[0]
    path = PurePosixPath(table.folder) / (first.files[0] if first.files else first.images or "")
    where = file.parent if images is None else f"--images {images}"
    to_do = (
        "Name the folder of the images with --images"
        if images is None
        else "Name the folder of the recording, or one above it"
    )
    raise ImageError(
        f"{where}: expected the images of camera '{first.name}' as '{path}' in this folder, found "
        f"none. {to_do}"
    )


def _base_folder(file: Path, table: ScanTable, camera: CameraTable, images: Path | None) -> Path:
    """Return the folder that the image paths start from.

    `folder` of the scan file is looked for under `images` whole, and then without its leading
    parts: so the folder of the recording, or any folder above it, can be given.
    """
    base = images if images is not None else file.parent
    parts = PurePosixPath(table.folder).parts
    tails = [base.joinpath(*parts[skip:]) for skip in range(len(parts) + 1)]
    probe = camera.files[0] if camera.files else (camera.images or "")
    folder = str(PurePosixPath(probe).parent)
    for tail in tails:
        if _matches(tail, camera, None) or bool(folder != "." and (tail / folder).is_dir()):
            return tail
    return tails[0] if tails[0].is_dir() else base


def _image_files(table: ScanTable, camera: CameraTable, base: Path, n_images: int) -> list[Path]:
    if camera.files is not None:
        return [base / name for name in camera.files]
    numbers = table.image_indices or list(range(n_images))
    indices = [camera.first_index + number for number in numbers]
    files = [_only_match(base, camera, index) for index in indices]
    missing = [index for index, file in zip(indices, files, strict=True) if file is None]
    if missing:
        raise ImageError(
            f"{base}: camera '{camera.name}': the plan lists {n_images} images "
            f"('{camera.images}', index {min(indices)}-{max(indices)}), but "
            f"{_list(missing)} missing. Record the scan again, correct "
            "the sequence, or leave out what is not there"
        )
    if table.extra_images == "error":
        _require_no_more(base, camera, indices)
    return [file for file in files if file is not None]


def _list(missing: list[int]) -> str:
    shown = ", ".join(str(index) for index in missing[:8])
    more = f" and {len(missing) - 8} more" if len(missing) > 8 else ""
    return f"index {shown}{more} {'is' if len(missing) == 1 else 'are'}"


def _matches(base: Path, camera: CameraTable, index: int | None) -> list[Path]:
    """Return the files of one index, or of any index if None."""
    assert camera.images is not None or camera.files is not None
    if camera.images is None:
        return [p for name in camera.files or () if (p := base / name).is_file()]
    path = PurePosixPath(camera.images)
    folder = base / path.parent
    if not folder.is_dir():
        return []
    if index is None:
        wanted = re.compile(_regex(path.name))
        return sorted(p for p in folder.iterdir() if wanted.fullmatch(p.name))
    name = path.name.format(index=index)
    if "*" not in name:
        return [folder / name] if (folder / name).is_file() else []
    escaped = "*".join(re.sub(r"([\[?])", r"[\1]", part) for part in name.split("*"))
    return sorted(p for p in folder.iterdir() if fnmatch.fnmatchcase(p.name, escaped))


def _regex(name: str) -> str:
    """Return the regular expression of a file name with ``{index}`` and ``*``."""
    pieces = re.split(r"(\{index[^}]*\}|\*)", name)
    return "".join(
        r"(?P<index>\d+)" if piece.startswith("{index") else ".*" if piece == "*"
        else re.escape(piece)
        for piece in pieces
    )  # fmt: skip


def _only_match(base: Path, camera: CameraTable, index: int) -> Path | None:
    found = _matches(base, camera, index)
    if len(found) > 1:
        raise ImageError(
            f"{base}: camera '{camera.name}': expected one file for image {index}, found "
            f"{len(found)}: {', '.join(p.name for p in found[:3])}. Make the pattern "
            f"'{camera.images}' narrower"
        )
    return found[0] if found else None


def _require_no_more(base: Path, camera: CameraTable, indices: list[int]) -> None:
    assert camera.images is not None
    wanted = re.compile(_regex(PurePosixPath(camera.images).name))
    numbers = [
        int(match["index"])
        for p in _matches(base, camera, None)
        if (match := wanted.fullmatch(p.name))
    ]
    more = sorted(set(numbers) - set(indices))
    if more:
        raise PlanError(
            f"{base}: camera '{camera.name}': the plan lists {len(indices)} images, but the folder "
            f"holds {len(numbers)}; index {more[0]} is not in the plan. Add what was projected "
            'to the sequence, or set extra_images = "ignore"'
        )


def _stack(
    table: ScanTable,
    camera: CameraTable,
    files: list[Path],
    pictures: list[Grey],
    plan: PatternPlan,
) -> ImageStack:
    first = pictures[0]
    for file, picture in zip(files, pictures, strict=True):
        if picture.shape != first.shape:
            raise ImageError(
                f"{file}: expected {_size(first)} pixels as in {files[0].name}, "
                f"found {_size(picture)}. Is it an image of another camera?"
            )
        if picture.dtype != first.dtype:
            raise ImageError(
                f"{file}: expected {first.dtype.itemsize * 8} bit as in {files[0].name}, "
                f"found {picture.dtype.itemsize * 8} bit. Convert one of them"
            )
    top = 2**table.bit_depth - 1
    brightest = max(int(picture.max()) for picture in pictures)
    fits_type = table.bit_depth <= 8 * first.dtype.itemsize
    if brightest > top or not fits_type:
        raise ImageError(
            f"{files[0].parent}: camera '{camera.name}': bit_depth = {table.bit_depth} allows grey "
            f"values up to {top}, found {first.dtype.itemsize * 8}-bit images with {brightest}. "
            "Correct bit_depth in the scan file"
        )
    if table.bit_depth > 8 and brightest <= top // 256:
        raise ImageError(
            f"{files[0].parent}: camera '{camera.name}': bit_depth = {table.bit_depth} was "
            f"declared, but no grey value exceeds {brightest}. Correct bit_depth, or the exposure"
        )
    return ImageStack(
        images=np.stack(pictures),
        plan=plan,
        device_name=camera.name,
        saturation_dn=table.saturation,
        black_level_dn=table.black_level_dn,
        noise=table.noise.model() if table.noise else None,
        is_lossy=any(file.suffix.lower() in LOSSY_SUFFIXES for file in files),
    )


def _size(image: Grey) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


def _require_fit(scan: Scan, rig_file: Path | None) -> None:
    """Refuse a rig that belongs to other cameras."""
    if scan.rig is None:
        return
    known = {camera.name: camera for camera in scan.rig.cameras}
    for stack in scan.stacks:
        camera = known.get(stack.device_name)
        if camera is None:
            raise RigError(
                f"{rig_file}: expected a camera '{stack.device_name}' as in the scan, found "
                f"{sorted(known)}. Is this the rig of another recording?"
            )
        if camera.shape != stack.shape:
            raise RigError(
                f"{rig_file}: camera '{camera.name}': calibrated for {camera.n_cols} x "
                f"{camera.n_rows} pixels, but the images have {stack.shape[1]} x {stack.shape[0]}. "
                "Is this the rig of another recording?"
            )


def image_size(images: Path, camera: dict[str, object], /) -> tuple[int, int]:
    """Return (width, height) of the first image of a ``[[cameras]]`` entry."""
    entry = CameraTable.model_validate(camera)
    found = _matches(images, entry, entry.first_index)
    if not found:
        raise ImageError(
            f"{images}: camera '{entry.name}': expected image {entry.first_index} of "
            f"'{entry.images}', found none"
        )
    first = read_image(found[0])
    return first.shape[1], first.shape[0]
