"""Scan folders and scan files to `Scan`: finding, counting and reading the images."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path, PurePosixPath

from fringe3d.decode import fuse
from fringe3d.errors import ImageError, PlanError, RigError
from fringe3d.io.images import Grey, read_image, read_images, read_stack
from fringe3d.io.noisefile import noise_for, read_noise
from fringe3d.io.responsefile import read_responses, response_for
from fringe3d.io.rigfile import read_rig
from fringe3d.io.scanfile import CameraTable, ScanTable, read_scan_table
from fringe3d.model import ImageStack, NoiseModel, PatternPlan, Rig, Scan

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
    with_rig: bool = True,
    response: Path | None = None,
    noise: Path | None = None,
    progress: Progress = _silent,
) -> Scan:
    """Read a scan folder, or the scan file of a recording that lies elsewhere.

    Parameters
    ----------
    path : folder with a ``scan.toml``, or a scan file
    images : folder of the images; that of the scan file if None
    rig : rig file that replaces the one named in the scan file
    with_rig : bool; False leaves out what the scan file says of a rig but the projector's size
    response : response file that replaces the one named in the scan file
    noise : noise file that replaces the noise model of the scan file
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
    the_rig = the_rig if with_rig else None
    _require_images(file, table, images)
    sources = [
        _source(table, camera, _base_folder(file, table, camera, images), table.n_recorded)
        for camera in table.cameras
    ]
    total = table.n_recorded * len(sources)
    stacks: list[ImageStack] = []
    models = read_noise(noise) if noise else {}
    for camera, source in zip(table.cameras, sources, strict=True):
        done = partial(_report, progress, table.n_recorded * len(stacks), total)
        pictures = _pictures(table, camera, source, done)
        model = noise_for(noise, models, camera.name) if noise else table.noise_model
        stacks.append(_fused(table, camera, source, pictures, plan, model))
    response = response or (file.parent / table.response if table.response else None)
    if response is not None:
        known = read_responses(response)
        stacks = [s.with_response(response_for(response, known, s.device_name)) for s in stacks]
    position = table.table.position() if table.table else None
    scan = Scan(stacks=tuple(stacks), rig=the_rig, title=table.title, table=position)
    _require_fit(scan, rig_file)
    return scan


def _report(progress: Progress, before: int, total: int, done: int) -> None:
    progress("reading images", before + done, total)


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
    path = PurePosixPath(table.folder) / first.first_file
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
    folder = str(PurePosixPath(camera.first_file).parent)
    for tail in tails:
        if _matches(tail, camera, None) or bool(folder != "." and (tail / folder).is_dir()):
            return tail
    return tails[0] if tails[0].is_dir() else base


def _source(table: ScanTable, camera: CameraTable, base: Path, n_images: int) -> list[Path]:
    """Return the files of the images, or the one file of all."""
    if camera.stack is not None:
        return [base / camera.stack]
    return _image_files(table, camera, base, n_images)


def _pictures(
    table: ScanTable, camera: CameraTable, source: list[Path], done: Callable[[int], None]
) -> Grey:
    """Return the images (pattern, row, col); those of a stack stay in their file."""
    if camera.stack is None:
        return read_images(source, channel=camera.channel, done=done)
    images, n_images = read_stack(source[0]), table.n_recorded
    n_needed = max(table.image_indices or [n_images - 1]) + 1
    if len(images) < n_needed or (len(images) > n_images and table.extra_images == "error"):
        raise ImageError(
            f"{source[0]}: camera '{camera.name}': the plan lists {n_images} images, found a stack "
            f"of {len(images)}. Record the scan again, correct the sequence, or set "
            'extra_images = "ignore"'
        )
    done(n_images)
    return images[table.image_indices] if table.image_indices else images[:n_images]


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
    if camera.images is None:
        names = camera.files if camera.files is not None else [camera.first_file]
        return [p for name in names if (p := base / name).is_file()]
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


def _fused(
    table: ScanTable,
    camera: CameraTable,
    source: list[Path],
    pictures: Grey,
    plan: PatternPlan,
    noise: NoiseModel | None,
) -> ImageStack:
    """Return the stack of a camera; several exposures, which follow each other, become one."""
    _require_depth(table, camera, source, pictures)
    exposures, n = table.exposures or [1.0], plan.n_images
    stacks = [
        _stack(table, camera, source, pictures[i * n : (i + 1) * n], plan, noise)
        for i in range(len(exposures))
    ]
    return fuse(stacks, exposures) if len(stacks) > 1 else stacks[0]


def _require_depth(
    table: ScanTable, camera: CameraTable, source: list[Path], pictures: Grey
) -> None:
    """Refuse grey values that do not go with the bit depth of the scan file."""
    where = source[0] if camera.stack is not None else source[0].parent
    n_bits = 8 * pictures.dtype.itemsize
    top = 2**table.bit_depth - 1
    # Eight bits of eight cannot be exceeded: then nothing has to be read.
    brightest = top if table.bit_depth == n_bits == 8 else int(pictures.max())
    if brightest > top or table.bit_depth > n_bits:
        raise ImageError(
            f"{where}: camera '{camera.name}': bit_depth = {table.bit_depth} allows grey "
            f"values up to {top}, found {n_bits}-bit images with {brightest}. "
            "Correct bit_depth in the scan file"
        )
    if table.bit_depth > 8 and brightest <= top // 256:
        raise ImageError(
            f"{where}: camera '{camera.name}': bit_depth = {table.bit_depth} was "
            f"declared, but no grey value exceeds {brightest}. Correct bit_depth, or the exposure"
        )


def _stack(
    table: ScanTable,
    camera: CameraTable,
    source: list[Path],
    pictures: Grey,
    plan: PatternPlan,
    noise: NoiseModel | None,
) -> ImageStack:
    return ImageStack(
        images=pictures,
        plan=plan,
        device_name=camera.name,
        saturation_dn=table.saturation,
        black_level_dn=table.black_level_dn,
        noise=noise,
        is_lossy=any(file.suffix.lower() in LOSSY_SUFFIXES for file in source),
    )


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
