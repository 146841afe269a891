"""Bad input ends in one clear message, exit code 2 and untouched folders, never in a traceback.

A message says where, what was expected, what was found and what to do. The tests show
that the named mistakes are caught; they do not prove that there are no others.
"""

from __future__ import annotations

import errno
import io
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from closed_form import SphereScene, demo_rig, simulate
from fringe3d.cli import main
from fringe3d.errors import OutputError
from fringe3d.io.atomic import write_text
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import PatternPlan
from fringe3d.patterns import sequence

SIZE = (160, 128)
PERIOD_PX = 32.0
"""Six camera pixels at this size: enough for two cameras."""

MEASURE = ("measure", "scan", "--out", "result")
AGAIN = ("--overwrite", "--method", "projector")
JARGON = r"Input should|validation error|Traceback|NoneType|\w+Error|pydantic|\\\["
"""Words of the libraries beneath, and marks of a console's mark-up."""

Change = Callable[[Path], object]
Image = NDArray[Any]
Tree = dict[str, bytes]


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a good scan folder; copy it before you change it."""
    folder = tmp_path_factory.mktemp("bad_input") / "scan"
    write_scan(folder, simulate(demo_rig(camera_size=SIZE), _plan(), SphereScene(), _rng())[0])
    return folder


def _plan() -> PatternPlan:
    return sequence((768, 1024), periods_px=(PERIOD_PX,), n_shifts=4)


def _rng() -> np.random.Generator:
    return np.random.default_rng(20261122)


@pytest.fixture(scope="session")
def earlier(pristine: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the result of the good scan; copy it before you change it."""
    out = tmp_path_factory.mktemp("bad_input") / "result"
    main(["measure", str(pristine), "--out", str(out)])
    return out


@pytest.fixture
def work(pristine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working directory, with a copy of the good scan in ``scan``."""
    shutil.copytree(pristine, tmp_path / "scan")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def tree(folder: Path) -> Tree:
    """Return all files below a folder with their bytes, and its folders."""
    paths = sorted(folder.rglob("*"))
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in paths}


def message_of(
    arguments: list[str], capsys: pytest.CaptureFixture[str], *, exit_code: int = 2
) -> str:
    """Run the command line, require a failure with one line on standard error, return it."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    printed = capsys.readouterr()
    assert exit_code == ended.value.code, printed.err
    assert printed.out == ""
    lines = printed.err.splitlines()
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("error: ")
    return lines[0].removeprefix("error: ")


# ---------------------------------------------------------------------------- what can be changed


def everything(*changes: Change) -> Change:
    """Return the change that makes all these changes, one after the other."""

    def apply(scan: Path) -> None:
        for change in changes:
            change(scan)

    return apply


def nothing(_scan: Path) -> None:
    """Leave the scan as it is."""


def replace(file: str, old: str, new: str, *, count: int = 1) -> Change:
    """Replace the first `count` places of a text; old text that is not there is a mistake."""

    def apply(scan: Path) -> None:
        text = (scan / file).read_text(encoding="utf-8")
        assert old in text, f"{file} holds no '{old}'"
        (scan / file).write_text(text.replace(old, new, count), encoding="utf-8")

    return apply


def set_key(file: str, key: str, value: str, *, which: int = 0) -> Change:
    """Give the key (of the entry `which`, where there are several) another value."""

    def apply(scan: Path) -> None:
        text = (scan / file).read_text(encoding="utf-8")
        found = list(re.finditer(rf"^{key} = (\[\n(?:    .*\n)*\]|.*)$", text, re.MULTILINE))
        assert len(found) > which, f"{file} holds no {key} no. {which}"
        start, end = found[which].span()
        (scan / file).write_text(f"{text[:start]}{value}{text[end:]}", encoding="utf-8")

    return apply


def at_top(file: str, line: str) -> Change:
    """Add a line at the start of a file."""

    def apply(scan: Path) -> None:
        text = (scan / file).read_text(encoding="utf-8")
        (scan / file).write_text(f"{line}\n{text}", encoding="utf-8")

    return apply


def at_end(file: str, text: str) -> Change:
    """Add text at the end of a file."""

    def apply(scan: Path) -> None:
        with (scan / file).open("a", encoding="utf-8") as stream:
            stream.write(text)

    return apply


def without_block(file: str, start: str) -> Change:
    """Remove the TOML table that starts with this text."""

    def apply(scan: Path) -> None:
        text = (scan / file).read_text(encoding="utf-8")
        before, after = text.split(start, 1)
        following = re.search(r"^\[", after.lstrip("["), re.MULTILINE)
        rest = after.lstrip("[")[following.start() :] if following else ""
        (scan / file).write_text(before + rest, encoding="utf-8")

    return apply


def volume(text: str) -> Change:
    """Replace the measuring volume."""

    def apply(scan: Path) -> None:
        without_block("rig.toml", "[volume]")(scan)
        with (scan / "rig.toml").open("a", encoding="utf-8") as file:
            file.write(f"\n[volume]\n{text}\n")

    return apply


def remove(*names: str) -> Change:
    """Remove files or folders."""

    def apply(scan: Path) -> None:
        for name in names:
            path = scan / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return apply


def write(name: str, data: bytes) -> Change:
    """Write a file."""

    def apply(scan: Path) -> None:
        (scan / name).parent.mkdir(exist_ok=True)
        (scan / name).write_bytes(data)

    return apply


def load(file: Path) -> Image:
    """Return an image as it is."""
    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image)


def picture(name: str, make: Callable[[Image], Image]) -> Change:
    """Replace an image by what `make` makes of it."""

    def apply(scan: Path) -> None:
        assert cv2.imwrite(str(scan / name), make(load(scan / name)))

    return apply


def pictures(make: Callable[[Image], Image]) -> Change:
    """Replace all images."""

    def apply(scan: Path) -> None:
        for path in sorted(scan.glob("c*/*.png")):
            picture(str(path.relative_to(scan)), make)(scan)

    return apply


def as_format(suffix: str) -> Change:
    """Convert the images of camera c1 to another format."""

    def apply(scan: Path) -> None:
        for path in sorted((scan / "c1").iterdir()):
            image = load(path)
            other = path.with_suffix(suffix)
            if suffix == ".tif":
                tifffile.imwrite(other, image)
            else:
                assert cv2.imwrite(str(other), image)
            path.unlink()
        replace("scan.toml", "c1/{index:03d}.png", f"c1/{{index:03d}}{suffix}")(scan)

    return apply


def cut(name: str, share: float) -> Change:
    """Keep only the first part of a file."""

    def apply(scan: Path) -> None:
        data = (scan / name).read_bytes()
        (scan / name).write_bytes(data[: int(share * len(data))])

    return apply


def spoil(name: str) -> Change:
    """Overwrite some bytes in the middle of a file."""

    def apply(scan: Path) -> None:
        data = bytearray((scan / name).read_bytes())
        middle = len(data) // 2
        data[middle : middle + 64] = bytes(64)
        (scan / name).write_bytes(data)

    return apply


def pickled_array() -> bytes:
    """Return a ``.npy`` file of Python objects."""
    file = io.BytesIO()
    np.save(file, np.array([None, "image"], object), allow_pickle=True)
    return file.getvalue()


def stacked(make: Callable[[Image], Image]) -> Change:
    """Return a change to one ``.npy`` stack for c1 in place of its images."""

    def apply(scan: Path) -> None:
        files = sorted((scan / "c1").glob("*.png"))
        np.save(scan / "c1.npy", make(np.stack([load(file) for file in files])))
        replace("scan.toml", 'images = "c1/{index:03d}.png"', 'stack = "c1.npy"')(scan)

    return apply


def float_tiff(scan: Path) -> None:
    """Make one image of c1 a TIFF of floating-point numbers."""
    as_format(".tif")(scan)
    file = scan / "c1" / "004.tif"
    tifffile.imwrite(file, tifffile.imread(file).astype(np.float32) / 255)


def five_channels(scan: Path) -> None:
    """Make one image of c1 a TIFF of five channels."""
    as_format(".tif")(scan)
    image = np.zeros((*SIZE[::-1], 5), np.uint8)
    tifffile.imwrite(
        scan / "c1" / "003.tif", image, photometric="minisblack", planarconfig="contig"
    )


def one_camera(scan: Path) -> None:
    """Leave out camera c2 of the scan."""
    without_block("scan.toml", '[[cameras]]\nname = "c2"')(scan)


def without_projector(scan: Path) -> None:
    """Leave out the projector of the rig."""
    without_block("rig.toml", '[[devices]]\nname = "projector"')(scan)


# ------------------------------------------------------------------------------------- the table


@dataclass(frozen=True)
class Case:
    """A change of the good scan, the command, and what its message must say."""

    name: str
    change: Change
    said: str
    arguments: tuple[str, ...] = ()
    command: tuple[str, ...] = MEASURE


IDENTITY = "rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]"
BEHIND = 'kind = "box"\nmin_mm = [-10, -10, 400]\nmax_mm = [10, 10, 500]'
EMPTY = 'kind = "half_spaces"\nnormals = [[0, 0, 1], [0, 0, -1]]\noffsets_mm = [-5, -5]'
UNEQUAL = 'kind = "half_spaces"\nnormals = [[0, 0, 1], [0, 0, -1]]\noffsets_mm = [-5]'
TWISTED = 'kind = "box"\nmin_mm = [-10, 10, -10]\nmax_mm = [10, -10, 10]'
SLAB = 'kind = "depth_slab"\ndevice = "{}"\ndepth_min_mm = {}\ndepth_max_mm = {}'
CYLINDER = (
    'kind = "cylinder"\ncenter_mm = [0, 0, 0]\naxis = [0, 0, {}]\nradius_mm = {}\nheight_mm = 20'
)

LISTED = [f"c1/{index:03d}.png" for index in range(10)]
N_STACKED = len(LISTED)

PATHS = [
    Case(
        "first image missing",
        remove("c1/000.png"),
        r"scan: camera 'c1': the plan lists 10 images.*index 0-9.*index 0 is missing\. Record",
    ),
    Case(
        "middle image missing",
        remove("c2/005.png"),
        r"scan: camera 'c2': the plan lists 10 images.*index 5 is missing\. Record",
    ),
    Case(
        "several images missing",
        remove("c2/003.png", "c2/005.png", "c2/009.png"),
        r"camera 'c2': the plan lists 10 images.*index 3, 5, 9 are missing\. Record",
    ),
    Case(
        "all images of a camera missing",
        remove("c2"),
        r"camera 'c2': the plan lists 10 images.*0, 1, 2, 3, 4, 5, 6, 7 and 2 more are missing",
    ),
    Case(
        "folder in place of an image",
        everything(remove("c1/003.png"), lambda scan: (scan / "c1/003.png").mkdir()),
        r"camera 'c1': the plan lists 10 images.*index 3 is missing\. Record",
    ),
    Case(
        "scan path missing",
        remove("../scan"),
        r"scan: expected a scan folder or a scan file, found neither\. Check the path",
    ),
    Case(
        "scan path too long",
        nothing,
        r"name too long.*\. Check the path",
        command=("measure", "a" * 300, "--out", "result"),
    ),
    Case(
        "folder without scan file",
        remove("scan.toml"),
        r"scan: expected a scan folder with a scan\.toml, found none\. Describe",
    ),
    Case(
        "rig of the scan missing",
        remove("rig.toml"),
        r"scan/rig\.toml: expected a file, found none\. Check the path",
    ),
    Case(
        "rig of the option missing",
        nothing,
        r"elsewhere/rig\.toml: expected a file, found none\. Check the path",
        ("--rig", "elsewhere/rig.toml"),
    ),
    Case(
        "folder in place of a rig",
        nothing,
        r"scan: expected a file, found a folder\. Name the file in it",
        ("--rig", "scan"),
    ),
    Case(
        "images folder missing",
        nothing,
        r"--images elsewhere: expected the folder of the images, found none\. Name the folder",
        ("--images", "elsewhere"),
    ),
    Case(
        "file in place of the images folder",
        nothing,
        r"--images scan/rig\.toml: expected the folder of the images, found a file\. Name the",
        ("--images", "scan/rig.toml"),
    ),
    Case(
        "images folder of something else",
        lambda scan: (scan / "../elsewhere").mkdir(),
        r"--images elsewhere: expected the images of camera 'c1' as 'c1/\{index:03d\}\.png' in "
        r"this folder, found none\. Name the folder of the recording",
        ("--images", "elsewhere"),
    ),
    Case(
        "images folder of something else for listed files",
        everything(
            at_top("scan.toml", 'folder = "set"'),
            replace("scan.toml", 'images = "c1/{index:03d}.png"', f"files = {LISTED}"),
            one_camera,
        ),
        r"--images scan/c2: expected the images of camera 'c1' as 'set/c1/000\.png' in this folder",
        ("--images", "scan/c2"),
    ),
    Case(
        "images that do not lie beside the scan file",
        remove("c1", "c2"),
        r"scan: expected the images of camera 'c1' as 'c1/\{index:03d\}\.png' in this folder, "
        r"found none\. Name the folder of the images with --images",
    ),
    Case(
        "stack with an image too few",
        stacked(lambda images: images[1:]),
        rf"scan/c1\.npy: camera 'c1': the plan lists {N_STACKED} images, found a stack of "
        rf"{N_STACKED - 1}\. Record",
    ),
    Case(
        "stack with an image too many",
        stacked(lambda images: images[[0, *range(len(images))]]),
        rf"the plan lists {N_STACKED} images, found a stack of {N_STACKED + 1}\..*extra_images",
    ),
    Case(
        "stack of one image",
        stacked(lambda images: images[0]),
        r"scan/c1\.npy: expected a stack of images \(pattern, row, col\), found shape \(\d+, \d+\)",
    ),
    Case(
        "stack of real numbers",
        stacked(lambda images: images.astype(np.float32)),
        r"scan/c1\.npy: expected samples of 8 or 16 bit \(uint8, uint16\), found <f4\. Convert",
    ),
    Case(
        "stack of objects",
        everything(stacked(lambda images: images), write("c1.npy", pickled_array())),
        r"scan/c1\.npy: expected a complete \.npy file, found one that cannot be read: .*objects",
    ),
    Case(
        "stack cut off",
        everything(stacked(lambda images: images), cut("c1.npy", 0.7)),
        r"expected a complete \.npy file, found one that cannot be read: .*with numpy\.save",
    ),
    Case(
        "stack of another camera's size",
        stacked(lambda images: images[:, :-8]),
        r"camera 'c1': calibrated for \d+ x \d+ pixels, but the images have",
    ),
    Case(
        "stack missing",
        everything(stacked(lambda images: images), remove("c1.npy"), one_camera),
        r"expected the images of camera 'c1' as 'c1\.npy' in this folder, found none",
    ),
    Case(
        "stack of another format",
        replace("scan.toml", 'images = "c1/{index:03d}.png"', 'stack = "c1.raw"'),
        r"stack: expected the name of a \.npy file, found 'c1\.raw'",
    ),
    Case(
        "stack beside image files",
        replace("scan.toml", 'name = "c1"', 'name = "c1"\nstack = "c1.npy"'),
        r"expected one of images \(a pattern\), files \(a list\) and stack \(a \.npy file\)",
    ),
    Case(
        "wildcard fits several files",
        replace("scan.toml", "c1/{index:03d}.png", "c1/0{index}*.png"),
        r"camera 'c1': expected one file for image 0, found 10: 000\.png, 001\.png.*narrower",
    ),
]

IMAGES = [
    Case(
        "image of another size",
        picture("c1/003.png", lambda image: image[:100]),
        r"c1/003\.png: expected 160 x 128 pixels as in 000\.png, found 160 x 100\. Is it",
    ),
    Case(
        "16-bit image among 8-bit ones",
        picture("c2/003.png", lambda image: image.astype(np.uint16)),
        r"c2/003\.png: expected 8 bit as in 000\.png, found 16 bit\. Convert",
    ),
    Case(
        "empty file",
        write("c1/003.png", b""),
        r"c1/003\.png: expected a complete image, found .* cut off after 0 bytes\. Copy",
    ),
    Case(
        "truncated PNG",
        cut("c1/003.png", 0.6),
        r"c1/003\.png: expected a complete image, found .* cut off after \d+ bytes\. Copy",
    ),
    Case(
        "PNG with wrong bytes inside",
        spoil("c1/003.png"),
        r"c1/003\.png: expected a PNG.* image, found a file that cannot be decoded\. Check",
    ),
    Case(
        "truncated JPEG",
        everything(as_format(".jpg"), cut("c1/003.jpg", 0.6)),
        r"c1/003\.jpg: expected a complete image, found .* cut off after \d+ bytes\. Copy",
    ),
    Case(
        "truncated BMP",
        everything(as_format(".bmp"), cut("c1/003.bmp", 0.6)),
        r"c1/003\.bmp: expected a complete image, found .* cut off after \d+ bytes\. Copy",
    ),
    Case(
        "truncated TIFF",
        everything(as_format(".tif"), cut("c1/003.tif", 0.6)),
        r"c1/003\.tif: expected .* image, found .* cannot be decoded: .*20480 bytes.*\. Copy",
    ),
    Case(
        "TIFF cut in its header",
        everything(as_format(".tif"), cut("c1/003.tif", 0.001)),
        r"c1/003\.tif: expected .* image, found a file that cannot be decoded: .*\. Copy",
    ),
    Case(
        "text named PNG",
        write("c1/003.png", b"this is not an image\n"),
        r"c1/003\.png: expected a PNG.* image, found a file that cannot be decoded\. Check",
    ),
    Case(
        "web page saved as the first image",
        write("c2/000.png", b"<html>404</html>"),
        r"c2/000\.png: expected a PNG.* image, found a file that cannot be decoded\. Check",
    ),
    Case(
        "TIFF of floating-point numbers",
        float_tiff,
        r"c1/004\.tif: expected samples of 8 or 16 bit, found float32\. Convert",
    ),
    Case(
        "TIFF of five channels",
        five_channels,
        r"c1/003\.tif: expected one grey or three colour channels, found .*5\)\. Convert",
    ),
    Case(
        "bit depth smaller than the data",
        everything(
            at_top("scan.toml", "bit_depth = 10"),
            pictures(lambda image: image.astype(np.uint16) * 16),
        ),
        r"scan/c1: .*bit_depth = 10 allows grey values up to 1023, found 16-bit .*\. Correct",
    ),
    Case(
        "16-bit images without a bit depth",
        pictures(lambda image: image.astype(np.uint16) * 256),
        r"scan/c1: .*bit_depth = 8 allows grey values up to 255, found 16-bit .*\. Correct",
    ),
    Case(
        "12 bit declared on 8-bit images",
        at_top("scan.toml", "bit_depth = 12"),
        r"scan/c1: .*bit_depth = 12 allows grey values up to 4095, found 8-bit .*\. Correct",
    ),
    Case(
        "16 bit declared on 8-bit values",
        everything(
            at_top("scan.toml", "bit_depth = 16"), pictures(lambda image: image.astype(np.uint16))
        ),
        r"scan/c1: .*bit_depth = 16 was declared, but no grey value exceeds \d{3}\. Correct",
    ),
    Case(
        "saturation below black level",
        at_top("scan.toml", "saturation_dn = 10.0\nblack_level_dn = 20.0"),
        r"scan\.toml: expected black_level_dn < saturation_dn <= 255.*found 20 and 10\. Correct",
    ),
    Case(
        "saturation above the bit depth",
        at_top("scan.toml", "saturation_dn = 1000.0"),
        r"scan\.toml: expected black_level_dn < saturation_dn <= 255.*found 0 and 1000\. Correct",
    ),
    Case(
        "all images black",
        pictures(np.zeros_like),
        r"no pixel of camera 'c1' gave a point: 20480 LOW_MODULATION\. Check exposure",
    ),
    Case(
        "all images saturated",
        pictures(lambda image: np.full_like(image, 255)),
        r"no pixel of camera 'c1' gave a point: 20480 SATURATED\. Check exposure",
    ),
    Case(
        "all images black and no rig",
        everything(pictures(np.zeros_like), set_key("scan.toml", "rig", "")),
        r"no pixel of camera 'c1' gave a phase: 20480 LOW_MODULATION\. Check exposure",
    ),
]

PLAN = [
    Case(
        "fewer patterns than images",
        set_key("scan.toml", "n_bits", "n_bits = 5"),
        r"scan: camera 'c1': the plan lists 9 images, but the folder holds 10; index 9 .*\. Add",
    ),
    Case(
        "more patterns than images",
        set_key("scan.toml", "n_shifts", "n_shifts = 6"),
        r"scan: camera 'c1': the plan lists 12 images.*index 10, 11 are missing\. Record",
    ),
    Case(
        "too few image indices",
        at_top("scan.toml", "image_indices = [0, 1, 2]"),
        r"scan\.toml: image_indices: expected 10 numbers.*, found 3\. Correct",
    ),
    Case(
        "no image indices",
        at_top("scan.toml", "image_indices = []"),
        r"scan\.toml: image_indices: expected 10 numbers.*, found 0\. Correct",
    ),
    Case(
        "one image index twice",
        at_top("scan.toml", "image_indices = [0, 1, 2, 3, 4, 5, 3, 7, 8, 0]"),
        r"scan\.toml: image_indices: expected a different image .*, found 0, 3 more than once\. C",
    ),
    Case(
        "unknown key",
        at_top("scan.toml", "bit_dept = 8"),
        r"scan\.toml: unknown key 'bit_dept'\. Did you mean 'bit_depth'\?",
    ),
    Case(
        "unknown key in the sequence",
        replace("scan.toml", "n_shifts", "n_shift"),
        r"scan\.toml: unknown key 'sequence\[0\]\.n_shift'\. Did you mean 'n_shifts'\?",
    ),
    Case(
        "unknown key like no other",
        at_top("scan.toml", "zzz = 8"),
        r"scan\.toml: unknown key 'zzz'\. Known keys: .*bit_depth, .*n_shifts",
    ),
    Case(
        "missing key",
        set_key("scan.toml", "period_px", ""),
        r"scan\.toml: the key 'sequence\[0\]\.period_px' is missing\. Add it",
    ),
    Case(
        "missing kind",
        replace("scan.toml", 'kind = "gray"', ""),
        r"scan\.toml: the key 'sequence\[1\]\.kind' is missing\. Add it",
    ),
    Case(
        "unknown kind",
        replace("scan.toml", 'kind = "gray"', 'kind = "grey"'),
        r"scan\.toml: sequence\[1\]: expected one of .*'gray'.*, found 'grey'\. Correct",
    ),
    Case(
        "TOML syntax error",
        replace("scan.toml", "n_shifts = 4", "n_shifts = 4 4"),
        r"scan\.toml: expected TOML, found a mistake: .*line 8, column 14.*\. Mend",
    ),
    Case(
        "scan file that is no text",
        write("scan.toml", b'title = "\xff\xfe"'),
        r"scan\.toml: cannot be read: 'utf-8' .*\. Check the file",
    ),
    Case(
        "another version of the format",
        set_key("scan.toml", "format", 'format = "fringe3d-scan/2"'),
        r"scan\.toml: format: expected 'fringe3d-scan/1', found 'fringe3d-scan/2'\. Is this",
    ),
    Case(
        "rig file in place of the scan file",
        lambda scan: shutil.copy(scan / "rig.toml", scan / "scan.toml"),
        r"scan\.toml: format: expected 'fringe3d-scan/1', found 'fringe3d-rig/1'\. Is this",
    ),
    Case(
        "word in place of a number",
        set_key("scan.toml", "n_shifts", 'n_shifts = "four"'),
        r"scan\.toml: sequence\[0\]\.n_shifts: expected a whole number, found 'four'\. Correct",
    ),
    Case(
        "two phase steps in the plan",
        set_key("scan.toml", "n_shifts", "n_shifts = 2"),
        r"scan\.toml: sequence\[0\]\.n_shifts: expected a number of at least 3, found 2\. Correct",
    ),
    Case(
        "phase steps said twice",
        set_key("scan.toml", "n_shifts", "n_shifts = 4\nshifts_deg = [0, 90, 180, 270]"),
        r"scan\.toml: sequence\[0\]: expected either n_shifts .* or shifts_deg, not both\. Correct",
    ),
    Case(
        "period of zero",
        set_key("scan.toml", "period_px", "period_px = 0"),
        r"scan\.toml: sequence\[0\]\.period_px: expected a number above 0.*, found 0\. Correct",
    ),
    Case(
        "negative period",
        set_key("scan.toml", "period_px", "period_px = -16.0"),
        r"scan\.toml: sequence\[0\]\.period_px: expected a number above 0.*, found -16\.0\. C",
    ),
    Case(
        "period NaN",
        set_key("scan.toml", "period_px", "period_px = nan"),
        r"scan\.toml: sequence\[0\]\.period_px: expected a finite number, found nan\. Correct",
    ),
    Case(
        "twenty Gray-code bits",
        set_key("scan.toml", "n_bits", "n_bits = 20"),
        r"scan\.toml: sequence\[1\]\.n_bits: expected a number of at most 16, found 20\. Correct",
    ),
    Case(
        "bit that the code has not",
        set_key("scan.toml", "n_bits", "n_bits = 6\nbits = [6, 5, 4, 3, 2, 1]"),
        r"scan\.toml: sequence\[1\]: .*expected 0 <= bit < n_bits, found .*bit=6.*\. Correct",
    ),
    Case(
        "empty sequence",
        everything(
            without_block("scan.toml", "[[sequence]]"),
            without_block("scan.toml", "[[sequence]]"),
            at_top("scan.toml", "sequence = []"),
        ),
        r"scan\.toml: sequence: expected at least 1 entries, found \[\]\. Correct",
    ),
    Case(
        "no cameras in the scan",
        everything(one_camera, without_block("scan.toml", "[[cameras]]")),
        r"scan\.toml: the key 'cameras' is missing\. Add it",
    ),
    Case(
        "one camera name twice",
        replace("scan.toml", 'name = "c2"', 'name = "c1"'),
        r"scan\.toml: cameras: expected different names, found \['c1', 'c1'\]\. Rename",
    ),
    Case(
        "no index in the path of the images",
        replace("scan.toml", "c1/{index:03d}.png", "c1/000.png"),
        r"scan\.toml: cameras\[0\] 'c1': images: expected a path with \{index\}.*\. Correct",
    ),
    Case(
        "negative noise",
        at_end("scan.toml", "\n[noise]\nread_noise_dn = -1.0\n"),
        r"scan\.toml: noise\.read_noise_dn: expected .* at least 0.*, found -1\.0\. Correct",
    ),
]

RIG = [
    Case(
        "unknown key in a device",
        set_key("rig.toml", "focal_px", "focal_pix = [575.0, 575.5]", which=1),
        r"rig\.toml: unknown key 'devices\[1\] 'c2': focal_pix'\. Did you mean 'focal_px'\?",
    ),
    Case(
        "missing key in a device",
        set_key("rig.toml", "center_px", "", which=1),
        r"rig\.toml: the key 'devices\[1\] 'c2': center_px' is missing\. Add it",
    ),
    Case(
        "TOML syntax error in the rig",
        replace("rig.toml", "[[devices]]", "[[devices]"),
        r"rig\.toml: expected TOML, found a mistake: .*line 6, column 10.*\. Mend",
    ),
    Case(
        "scan file in place of the rig file",
        nothing,
        r"scan\.toml: format: expected 'fringe3d-rig/1', found 'fringe3d-scan/1'\. Is this",
        ("--rig", "scan/scan.toml"),
    ),
    Case(
        "NaN in a rotation",
        replace("rig.toml", "0.9722793263900706", "nan"),
        r"rig\.toml: devices\[0\] 'c1': rotation\[0\]\[0\]: expected a finite .* nan\. Correct",
    ),
    Case(
        "singular rotation",
        set_key("rig.toml", "rotation", IDENTITY.replace("0.0, 1.0]]", "0.0, 0.0]]")),
        r"rig\.toml: device 'c1': rotation: expected an orthonormal .* determinant of 0\. Correct",
    ),
    Case(
        "mirrored rotation",
        set_key("rig.toml", "rotation", IDENTITY.replace("0.0, 1.0]]", "0.0, -1.0]]"), which=1),
        r"rig\.toml: device 'c2': rotation: expected an orthonormal .* determinant of -1\. Correct",
    ),
    Case(
        "rotation of scale two",
        set_key("rig.toml", "rotation", IDENTITY.replace("1.0", "2.0")),
        r"rig\.toml: device 'c1': rotation: expected an orthonormal .* determinant of 8\. Correct",
    ),
    Case(
        "rotation of two rows",
        set_key("rig.toml", "rotation", "rotation = [[1, 0, 0], [0, 1, 0]]"),
        r"rig\.toml: devices\[0\] 'c1': rotation: expected at least 3 entries, found 2\. Correct",
    ),
    Case(
        "focal length of zero",
        set_key("rig.toml", "focal_px", "focal_px = [0.0, 575.5]"),
        r"rig\.toml: device 'c1': focal_px: expected positive numbers, found \[0\.0.*\. Correct",
    ),
    Case(
        "size of zero",
        set_key("rig.toml", "size", "size = [0, 128]"),
        r"rig\.toml: device 'c1': size: expected positive .*, found 0 x 128\. Correct",
    ),
    Case(
        "size with a fraction",
        set_key("rig.toml", "size", "size = [160.5, 128]"),
        r"rig\.toml: devices\[0\] 'c1': size\[0\]: expected a whole number, found 160\.5\. Correct",
    ),
    Case(
        "three numbers of distortion",
        set_key("rig.toml", "distortion", "distortion = [0.1, 0.2, 0.3]"),
        r"rig\.toml: device 'c1': distortion: expected \(0, 4, 5.* found 3\. Correct",
    ),
    Case(
        "role that is none",
        set_key("rig.toml", "role", 'role = "printer"'),
        r"rig\.toml: devices\[0\] 'c1': role: expected 'camera' or .*, found 'printer'\. Correct",
    ),
    Case(
        "volume behind the camera",
        volume(BEHIND),
        r"rig\.toml: volume: expected it in front of device 'c1', found it wholly behind.*Correct",
    ),
    Case(
        "empty volume",
        volume(EMPTY),
        r"rig\.toml: volume: expected some points inside, found none .*Correct",
    ),
    Case(
        "box with min above max",
        volume(TWISTED),
        r"rig\.toml: volume: expected min_mm below max_mm .*found \[-10\.0, 10\.0, .*Correct",
    ),
    Case(
        "depth slab of an unknown device",
        volume(SLAB.format("c3", 300, 400)),
        r"rig\.toml: volume: expected one of the devices \['c1'.*\], found 'c3'\. Correct",
    ),
    Case(
        "depth slab reversed",
        volume(SLAB.format("c1", 400, 300)),
        r"rig\.toml: volume: expected depth_min_mm below depth_max_mm, found 400.* 300.*Correct",
    ),
    Case(
        "cylinder without direction",
        volume(CYLINDER.format(0, 40)),
        r"rig\.toml: volume\.axis: expected a direction, found \[0, 0, 0\]\. Correct",
    ),
    Case(
        "cylinder without radius",
        volume(CYLINDER.format(1, 0)),
        r"rig\.toml: volume: expected positive radius_mm and height_mm, found 0.*Correct",
    ),
    Case(
        "half-spaces without offsets",
        volume(UNEQUAL),
        r"rig\.toml: volume: offsets_mm: expected shape \(2,\), found \(1,\)\. Correct",
    ),
    Case(
        "volume of unknown kind",
        volume('kind = "ball"'),
        r"rig\.toml: volume: expected one of the kinds 'box', .*, found 'ball'\. Correct",
    ),
    Case(
        "one device name twice",
        replace("rig.toml", 'name = "c2"', 'name = "c1"'),
        r"rig\.toml: rig: expected a different name for each device, found \['c1', 'c1'.*Correct",
    ),
    Case(
        "no camera in the rig",
        everything(
            without_block("rig.toml", "[[devices]]"), without_block("rig.toml", "[[devices]]")
        ),
        r"rig\.toml: rig: expected at least one device with role 'camera', found none\. Correct",
    ),
    Case(
        "two projectors",
        replace("rig.toml", 'role = "camera"', 'role = "projector"'),
        r"rig\.toml: rig: expected at most one projector, found 2\. Correct",
    ),
    Case(
        "rig with a camera of another size",
        set_key("rig.toml", "size", "size = [640, 512]"),
        r"rig\.toml: camera 'c1': calibrated for 640 x 512 pixels.* 160 x 128\. Is this",
    ),
    Case(
        "rig without the camera of the scan",
        replace("scan.toml", 'name = "c2"', 'name = "left"'),
        r"rig\.toml: expected a camera 'left' as in the scan, found \['c1', 'c2'\]\. Is this",
    ),
    Case(
        "projector size that contradicts the rig",
        at_top("scan.toml", "projector_size = [1920, 1080]"),
        r"scan\.toml: projector_size: .*1024 x 768 pixels, found \[1920, 1080\]\. Correct",
    ),
    Case(
        "two cameras in one place",
        everything(
            set_key("rig.toml", "rotation", IDENTITY),
            set_key("rig.toml", "rotation", IDENTITY, which=1),
            without_block("rig.toml", "[volume]"),
        ),
        r"0\.00% of the decoded pixels gave a point; the calibration .* does not belong",
    ),
]

OPTIONS = [
    Case("depth is no range", nothing, r"--depth: expected MIN:MAX.*'near'", ("--depth", "near")),
    Case("depth of one number", nothing, r"--depth: expected MIN:MAX.*'300'", ("--depth", "300")),
    Case(
        "depth reversed",
        nothing,
        r"--depth: expected .*MIN below MAX.*'400:300'",
        ("--depth", "400:300"),
    ),
    Case("depth NaN", nothing, r"--depth: expected .* finite.*'nan:3'", ("--depth", "nan:3")),
    Case("depth infinite", nothing, r"--depth: expected .* finite.*'1:inf'", ("--depth", "1:inf")),
    Case(
        "depth behind the camera",
        nothing,
        r"--depth: expected .*MAX above 0.*'-300:-200'",
        ("--depth=-300:-200",),
    ),
    Case(
        "depth outside the volume",
        nothing,
        r"no pixel of camera 'c1' gave a point: .*\d+ OUTSIDE_VOLUME\. Check",
        ("--depth", "10:20"),
    ),
    Case(
        "two phase steps wanted",
        nothing,
        r"--shifts: expected 3 to 4 of the 4 recorded phase steps, found 2",
        ("--shifts", "2"),
    ),
    Case(
        "99 phase steps wanted",
        nothing,
        r"--shifts: expected 3 to 4 of the 4 recorded phase steps, found 99",
        ("--shifts", "99"),
    ),
    Case(
        "word in place of the phase steps",
        nothing,
        r'--shifts: .*"four" into int\. See fringe3d measure --help',
        ("--shifts", "four"),
    ),
    Case(
        "negative number of bits",
        nothing,
        r'"-1" for --gray-bits\. Expected a number of at least 0\. See fringe3d measure --help',
        ("--gray-bits=-1",),
    ),
    Case(
        "M1 without Gray code",
        nothing,
        r"--method m1: expected a Gray code, found fringes alone\. Use --method m5 or m3",
        ("--gray-bits", "0", "--method", "m1"),
    ),
    Case(
        "M2 with full Gray code",
        nothing,
        r"--method m2: expected a reduced Gray code, found a full one\. Use --method m1",
        ("--method", "m2", "--gray-bits", "6"),
    ),
    Case(
        "M1 with one camera",
        one_camera,
        r"--method m1: expected .*two cameras, found 1 camera.*Use --method projector",
        ("--method", "m1"),
    ),
    Case(
        "M1 without a rig",
        set_key("scan.toml", "rig", ""),
        r"--method m1: expected a calibrated rig, found none\. Name one with --rig",
        ("--method", "m1"),
    ),
    Case(
        "method projector without a projector",
        without_projector,
        r"--method projector: expected a calibrated projector.*found none\. Use --method m1",
        ("--method", "projector"),
    ),
    Case(
        "unknown method",
        nothing,
        r'"m7" for --method\. Choose from: "auto", "m0", "m1"',
        ("--method", "m7"),
    ),
    Case(
        "negative contrast",
        nothing,
        r'"-1\.0" for --min-modulation\. Expected .* at least 0\.',
        ("--min-modulation=-1",),
    ),
    Case(
        "contrast NaN",
        nothing,
        r'"nan" for --min-modulation\. Expected .* at least 0\.',
        ("--min-modulation", "nan"),
    ),
    Case(
        "unknown option",
        nothing,
        r"Unknown option: --fast\. See fringe3d measure --help",
        ("--fast",),
    ),
    Case(
        "second scan",
        nothing,
        r"measure: expected nothing more, found scan2\. See fringe3d measure",
        ("scan2",),
    ),
    Case(
        "no output named",
        nothing,
        r"measure: expected --out, found none",
        command=("measure", "scan"),
    ),
    Case(
        "unknown command",
        nothing,
        r'Unknown command "measur"\. Did you mean "measure"\?',
        command=("measur", "scan"),
    ),
]

PATTERNS = [
    Case(name, nothing, said, arguments, ("patterns", "--out", "result"))
    for name, arguments, said in (
        ("patterns of no size", ("--size", "10by10", "--period", "16"), r"--size: .*'10by10'"),
        ("patterns of zero width", ("--size", "0x7", "--period", "16"), r"--size: .*'0x7'"),
        ("patterns of one length", ("--size", "1024", "--period", "16"), r"--size: .*'1024'"),
        ("patterns without a size", ("--period", "16"), r"patterns: expected --size, found none"),
        (
            "patterns without a period",
            ("--size", "64x48"),
            r"patterns: expected --period, the .* found none",
        ),
        ("patterns of period 0", ("--size", "64x48", "--period", "0"), r"at least 2 px.*found 0\."),
        ("patterns of period -8", ("--size", "64x48", "--period=-8"), r"at least 2 px.*found -8\."),
        (
            "patterns of period 1.9",
            ("--size", "64x48", "--period", "1.9"),
            r"least 2 .*found 1\.9\.",
        ),
        (
            "patterns of period NaN",
            ("--size", "64x48", "--period", "nan"),
            r"least 2 .*found nan\.",
        ),
        (
            "patterns of half a pixel",
            ("--size", "64x48", "--period", "0.5", "--steps", "0"),
            r"at least 1 px \(cells of a code .*found 0\.5\.",
        ),
        (
            "patterns of one period twice",
            ("--size", "64x48", "--period", "8", "--period", "8"),
            r"expected different periods, found \[8\.0, 8\.0\]\.",
        ),
        (
            "patterns of a period as wide as the projector",
            ("--size", "64x48", "--period", "64"),
            r"expected a period below 64 px .*found 64: there is nothing to number\. Choose",
        ),
        (
            "patterns of a period higher than the projector",
            ("--size", "64x48", "--period", "48", "--direction", "y"),
            r"expected a period below 48 px .*found 48",
        ),
        (
            "patterns of an angle and a direction",
            ("--size", "64x48", "--period", "8", "--angle", "30", "--direction", "x"),
            r"--angle, --direction: expected one of them, found 30 and x\. Leave one out",
        ),
        (
            "patterns of more Gray-code bits than periods",
            ("--size", "64x48", "--period", "8", "--gray-bits", "4"),
            r"gray_bits from 1 to 3 \(3 number all periods of 8 px\), found 4\.",
        ),
        (
            "patterns of Gray-code bits without a code",
            ("--size", "64x48", "--period", "8", "--gray", "none", "--gray-bits", "2"),
            r"expected no gray_bits with gray none, found 2\.",
        ),
        (
            "patterns of one step",
            ("--size", "64x48", "--period", "16", "--steps", "1"),
            r"expected at least 3 phase steps, found 1\.",
        ),
        (
            "patterns of two steps",
            ("--size", "64x48", "--period", "16", "--steps", "2"),
            r"expected at least 3 phase steps, found 2\. See fringe3d patterns --help",
        ),
        (
            "patterns of twelve bits",
            ("--size", "64x48", "--period", "16", "--bits", "12"),
            r'"12" for --bits\. Choose from: 8, 16',
        ),
        (
            "patterns of no Gray-code bits",
            ("--size", "64x48", "--period", "16", "--gray-bits", "0"),
            r'"0" for --gray-bits\. Expected a number of at least 1',
        ),
        (
            "patterns of nothing",
            ("--size", "64x48", "--period", "16", "--steps", "0", "--gray", "none"),
            r"expected at least one pattern, found none\. See fringe3d patterns --help",
        ),
    )
]

FRINGES, CODE = "fringes period_px=32 n_shifts=4", "gray cell_px=16 n_bits=6"
IMPORT = ("import", "scan", "--out", "new.toml")
CAMERA = ("--camera", "c1=c1/{index:03d}.png")

IMPORTS = [
    Case(
        "import of a missing folder",
        nothing,
        r"elsewhere: expected the folder of the images, found none",
        command=("import", "elsewhere"),
    ),
    Case(
        "import of a camera without a path",
        nothing,
        r"--camera: expected NAME=PATTERN.*, found 'c1'",
        ("--camera", "c1", "--sequence", FRINGES),
        IMPORT,
    ),
    Case(
        "import of a sequence without values",
        nothing,
        r"--sequence 'fringes 32': expected KIND KEY=VALUE .*, found '32'",
        (*CAMERA, "--sequence", "fringes 32"),
        IMPORT,
    ),
    Case(
        "import of shifts that are no numbers",
        nothing,
        r"--sequence '.*': shifts_deg: expected numbers with commas .*, found '0,abc,9'\. Correct",
        (*CAMERA, "--sequence", "fringes period_px=32 shifts_deg=0,abc,9"),
        IMPORT,
    ),
    Case(
        "import of an unknown kind",
        nothing,
        r"--sequence 'grey n_bits=3': expected one of the kinds .*gray.*, found 'grey'\. Correct",
        (*CAMERA, "--sequence", FRINGES, "--sequence", "grey n_bits=3"),
        IMPORT,
    ),
    Case(
        "import of a first index that is none",
        nothing,
        r"--camera 'c1=.*@x': expected a whole number, .*, found 'x'\. Correct",
        ("--camera", "c1=c1/{index:03d}.png@x", "--sequence", FRINGES),
        IMPORT,
    ),
    Case(
        "import of a calibration of unknown kind",
        write("stereo.yml", b"garbage: ["),
        r"stereo\.yml: expected OpenCV YAML, XML or JSON, found something else\. Check",
        (*CAMERA, "--sequence", FRINGES, "--sequence", CODE, "--calibration", "scan/stereo.yml"),
        IMPORT,
    ),
]

OUTPUTS = [
    Case(
        "output exists",
        lambda scan: (scan / "../result").mkdir(),
        r"result: expected a path that does not exist yet, found an existing folder\..*--overwrite",
    ),
    Case(
        "output of the patterns exists",
        lambda scan: (scan / "../result").mkdir(),
        r"result: expected a path that does not exist yet, found an existing folder\..*--overwrite",
        command=("patterns", "--size", "64x48", "--period", "16", "--out", "result"),
    ),
    Case(
        "output of the demo exists",
        nothing,
        r"scan: expected a path that does not exist yet, found an existing folder\..*--overwrite",
        command=("demo", "--out", "scan"),
    ),
    Case(
        "output below a file",
        nothing,
        r"scan\.toml/result: expected a writable folder.*is not a folder\. Choose another",
        command=("measure", "scan", "--out", "scan/scan.toml/result"),
    ),
    Case(
        "folder of the user in place of an earlier result",
        write("../notes/keep.txt", b"mine"),
        r"notes: expected an earlier result to replace.*, found another folder\. Choose another",
        command=("measure", "scan", "--out", "notes", "--overwrite"),
    ),
    Case(
        "scan in place of an earlier result",
        nothing,
        r"scan: expected a path apart from the input, found that it holds scan\. Choose another",
        command=("measure", "scan", "--out", "scan", "--overwrite"),
    ),
    Case(
        "folder above the scan in place of an earlier result",
        nothing,
        r"\.: expected a path apart from the input, found that it holds scan\. Choose another",
        command=("measure", "scan", "--out", ".", "--overwrite"),
    ),
    Case(
        "folder of the rig in place of an earlier result",
        lambda scan: shutil.copy(scan / "rig.toml", scan / "c1"),
        r"scan/c1: expected a path apart from the input, .* holds scan/c1/rig\.toml\. Choose",
        ("--rig", "scan/c1/rig.toml", "--overwrite"),
        ("measure", "scan", "--out", "scan/c1"),
    ),
]

CASES = [*PATHS, *IMAGES, *PLAN, *RIG, *OPTIONS, *PATTERNS, *IMPORTS, *OUTPUTS]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name.replace(" ", "_"))
def test_bad_input_ends_in_one_message_and_leaves_every_file_as_it_was(
    case: Case, work: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case.change(work / "scan")
    before = tree(work)
    message = message_of([*case.command, *case.arguments], capsys)
    assert re.search(case.said, message), f"expected /{case.said}/, found: {message}"
    assert not re.search(JARGON, message), message
    assert before == tree(work)


def test_read_only_folder_is_refused_before_the_work_starts(
    work: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root may write everywhere, so the answer of the system is set here."""
    before = tree(work)
    monkeypatch.setattr("fringe3d.io.atomic.os.access", lambda *_: False)
    monkeypatch.setattr("fringe3d.io.recording.read_scan", None)
    message = message_of([*MEASURE], capsys)
    assert re.search(r"result: expected a writable folder, .* is read-only for you\. Ch", message)
    assert before == tree(work)


# -------------------------------------------------------------- what is there stays until success


def test_overwrite_replaces_the_whole_result_of_a_good_scan(work: Path, earlier: Path) -> None:
    """The scan that all cases spoil is good: only the spoiling makes them fail."""
    shutil.copytree(earlier, work / "result")
    (work / "result" / "extra.txt").write_text("from an earlier run", encoding="utf-8")
    first = tree(work / "result")
    main([*MEASURE, *AGAIN])
    second = tree(work / "result")
    assert set(first) - {"extra.txt"} == set(second)
    assert first["points.npz"] != second["points.npz"]
    assert {"scan", "result"} == {path.name for path in work.iterdir()}


@pytest.mark.parametrize("case", [IMAGES[3], PLAN[0], RIG[4], OPTIONS[6]], ids=lambda c: c.name)
def test_failing_second_run_leaves_the_first_result_byte_for_byte(
    case: Case, work: Path, earlier: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(earlier, work / "result")
    case.change(work / "scan")
    before = tree(work)
    message_of([*MEASURE, "--overwrite", *case.arguments], capsys)
    assert before == tree(work)


@dataclass(frozen=True)
class Breakdown:
    """Something that happens in the middle of the work."""

    place: str
    problem: BaseException
    exit_code: int
    said: str

    def __call__(self, *_args: object, **_kwargs: object) -> None:
        """Happen."""
        raise self.problem


FULL_DISK = OSError(errno.ENOSPC, "No space left on device")
BREAKDOWNS = [
    Breakdown("fringe3d.io.images.read_image", KeyboardInterrupt(), 130, "nothing was written"),
    Breakdown("fringe3d.pipeline.triangulate", KeyboardInterrupt(), 130, "nothing was written"),
    Breakdown("fringe3d.report.folder.write_ply", KeyboardInterrupt(), 130, "nothing was written"),
    Breakdown(
        "fringe3d.report.folder.write_overview", KeyboardInterrupt(), 130, "nothing was written"
    ),
    Breakdown("fringe3d.report.folder.write_overview", FULL_DISK, 2, "result: .*No space left"),
    Breakdown("pathlib.Path.mkdir", FULL_DISK, 2, "result: .*No space left"),
]


@pytest.mark.parametrize("has_result", [False, True], ids=["first_run", "second_run"])
@pytest.mark.parametrize("breakdown", BREAKDOWNS, ids=lambda b: f"{b.place}_{b.exit_code}")
def test_breakdown_in_the_middle_of_the_work_leaves_every_file_as_it_was(
    breakdown: Breakdown,
    has_result: bool,
    work: Path,
    earlier: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if has_result:
        shutil.copytree(earlier, work / "result")
    before = tree(work)
    monkeypatch.setattr(breakdown.place, breakdown)
    message = message_of([*MEASURE, *AGAIN], capsys, exit_code=breakdown.exit_code)
    assert re.search(breakdown.said, message)
    assert before == tree(work)


@pytest.mark.parametrize("problem", [KeyboardInterrupt(), FULL_DISK], ids=["interrupt", "disk"])
def test_result_comes_back_when_the_last_step_of_its_replacement_fails(
    problem: BaseException,
    work: Path,
    earlier: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(earlier, work / "result")
    before = tree(work)
    rename = Path.rename

    def fail_for_the_new_result(self: Path, target: Path) -> Path:
        if ".partial-" in self.name:
            raise problem
        return rename(self, target)

    monkeypatch.setattr("fringe3d.report.folder.write_overview", lambda *_, **__: None)  # slow
    monkeypatch.setattr(Path, "rename", fail_for_the_new_result)
    exit_code = 2 if problem is FULL_DISK else 130
    message_of([*MEASURE, *AGAIN], capsys, exit_code=exit_code)
    assert before == tree(work)


def test_text_file_that_cannot_be_written_leaves_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scan.toml").write_text("old", encoding="utf-8")
    before = tree(tmp_path)
    monkeypatch.setattr(Path, "replace", Breakdown("", FULL_DISK, 2, ""))
    with pytest.raises(OutputError, match=r"scan\.toml: cannot be written: .*No space left"):
        write_text(tmp_path / "scan.toml", "new", overwrite=True)
    assert before == tree(tmp_path)
