"""The questions of ``fringe3d import``; every answer is checked when it is given."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fringe3d.cli.console import fail
from fringe3d.errors import Fringe3DError, PlanError, RigError
from fringe3d.io.atomic import require_writable
from fringe3d.io.importing import (
    count_images,
    grey_values,
    guess_cameras,
    has_known_keys,
    image_files,
    matrix_names,
    parse_bit_depth,
    parse_camera,
    parse_depth,
    parse_keys,
    parse_sequence,
    parse_size,
    propose_bit_depth,
    read_calibration,
    require_images,
)
from fringe3d.io.rigfile import read_rig
from fringe3d.model import Rig

CAMERA_HELP = """\
Cameras, as NAME=PATTERN@FIRST: {index:03d} is the number of an image, FIRST that of the first.
Enter takes the proposal in brackets, - leaves it out."""

SEQUENCE_HELP = """\
What was projected, in recorded order. Enter ends the list, - takes the last entry back.
  fringes period_px=60 n_shifts=12 direction=x shift_direction=-1 phase_offset_deg=-180
  gray cell_px=30 n_bits=6 direction=x inverses=interleaved bright_is=1
  light | dark | unused count=2"""

CALIBRATIONS = (".yml", ".yaml", ".xml", ".json", ".toml")

RIG_HELP = """\
The file of a calibration by OpenCV (.yml, .xml, .json) or of a rig (.toml). Enter for none:
then there will be phases but no points."""

KEYS_HELP = """\
Which are matrix and distortion of the first and of the second device, rotation and translation?
M1,D1,M2,D2,R,T, with :projector behind if the second device is one. Enter for another file."""

N_CAMERAS = 2
"""More are asked for only where the folder proposes more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """What the user said, as said; see ``fringe3d import --help``."""

    images: Path
    out: Path
    cameras: tuple[str, ...]
    sequence: tuple[str, ...]
    projector_size: str | None
    rig: Path | None
    calibration: Path | None
    calibration_keys: str | None
    inverse_pose: bool
    depth: str | None
    bit_depth: int | None
    black_level: float
    title: str
    overwrite: bool

    @property
    def rig_out(self) -> Path:
        """Return where a converted calibration goes: beside the scan file, named after it."""
        is_usual = self.out.name == "scan.toml"
        return self.out.with_name("rig.toml" if is_usual else f"{self.out.stem}-rig.toml")

    @property
    def without_effect(self) -> list[str]:
        """Return the options that mean nothing without a calibration, if there is none."""
        given = {
            "--calibration-keys": self.calibration_keys,
            "--inverse-pose": self.inverse_pose,
            "--depth": self.depth,
        }
        return [] if self.calibration else [name for name, value in given.items() if value]


def complete(options: ImportOptions, /) -> ImportOptions:
    """Ask for whatever the options leave open.

    Raises
    ------
    PlanError
        If the input ends before the last answer.
    """
    with suppress(ImportError):  # Windows edits lines without it
        import readline  # noqa: F401  (the arrow keys then recall and mend an answer)
    try:
        options = _ask_all(options)
    except EOFError:
        raise PlanError(
            "import: expected an answer, found the end of the input (Ctrl-D); nothing was "
            "written. Begin again, or give the answers as options (see --help)"
        ) from None
    _tell(f"The same without questions:\n  {_command(options)}")
    return options


def _ask_all(options: ImportOptions) -> ImportOptions:
    if not options.cameras:
        options = replace(options, cameras=_ask_cameras(options.images))
    cameras = [parse_camera(text) for text in options.cameras]
    if not options.sequence:
        options = replace(options, sequence=_ask_sequence(options.images, cameras[0]))
    if options.bit_depth is None:
        options = replace(options, bit_depth=_ask_bit_depth(options.images, cameras))
    options, rig = _ask_rig(options, cameras)
    if options.projector_size is None and not (options.rig and rig and rig.projector):
        options = replace(options, projector_size=_ask_projector_size(rig))
    if options.calibration and options.depth is None:
        options = replace(options, depth=_ask_depth(cameras[0]["name"]))
    if options.without_effect:
        _tell(f"Left out, as no calibration is imported: {', '.join(options.without_effect)}")
        options = replace(options, calibration_keys=None, inverse_pose=False, depth=None)
    return options


def _ask_cameras(images: Path) -> tuple[str, ...]:
    proposals = guess_cameras(images)
    answers: list[str] = []

    def check(answer: str) -> None:
        if answer in ("", "-"):
            if not (answers or default):
                raise PlanError("--camera: expected at least one camera, found none. Describe it")
            return
        entry = parse_camera(answer)
        if entry["name"] in [parse_camera(earlier)["name"] for earlier in answers]:
            raise PlanError(
                f"--camera '{answer}': expected another name, found that of an earlier camera. "
                "Rename it"
            )
        require_images(images, entry)

    _tell(CAMERA_HELP)
    while proposals or len(answers) < N_CAMERAS:
        default = proposals.pop(0) if proposals else ""
        hint = "" if default or not answers else " (Enter if there is none)"
        answer = _ask(f"Camera {len(answers) + 1}{hint}", check, default=default)
        if answer not in ("", "-"):
            answers.append(answer)
        elif answers and not default:
            break
    return tuple(answers)


def _ask_sequence(images: Path, camera: dict[str, Any]) -> tuple[str, ...]:
    numbers = [n for n in image_files(images, camera) if n >= camera.get("first_index", 0)]
    answers: list[str] = []

    def check(answer: str) -> None:
        if answer not in ("", "-"):
            parse_sequence(answer)
        elif not answer and left:
            raise PlanError(
                f"--sequence: expected {len(numbers)} images, as camera '{camera['name']}' has, "
                f"found {len(numbers) - left}. "
                + (f"Name the rest (or: unused count={left})" if left > 0 else "Take one back by -")
            )

    _tell(SEQUENCE_HELP)
    while True:
        left = len(numbers) - count_images(answers)
        hint = f"{left} left" if left > 0 else f"{-left} too many" if left else "complete"
        answer = _ask(f"Images {len(answers) + 1} ({hint})", check)
        if not answer:
            return tuple(answers)
        answers = answers[:-1] if answer == "-" else [*answers, answer]


def _ask_bit_depth(images: Path, cameras: Sequence[dict[str, Any]]) -> int:
    bits, brightest = grey_values(images, cameras)

    def check(answer: str) -> None:
        parse_bit_depth(answer, file_bits=bits, brightest=brightest)

    question = "Bit depth" if bits == 8 else f"Bit depth (brightest grey value {brightest})"
    return int(_ask(question, check, default=str(propose_bit_depth(bits, brightest))))


def _ask_rig(
    options: ImportOptions, cameras: Sequence[dict[str, Any]]
) -> tuple[ImportOptions, Rig | None]:
    """Return the options with a calibration, a rig file or neither, and the rig in it."""
    path = options.rig or options.calibration
    asked = False
    while True:
        try:
            if path is not None:
                return _with_rig(options, path, cameras)
            if not asked:
                _tell(RIG_HELP)
            asked = True
            path = _path(_line("Calibration or rig: "), options.images)
            if path is None:
                return replace(options, rig=None, calibration=None), None
        except Fringe3DError as problem:
            fail(str(problem))
            path = None


def _path(answer: str, images: Path) -> Path | None:
    """Return the file that is meant: from here, or else beside the images."""
    # A terminal puts quotes around the path of a file that is dropped on it.
    bare = answer.strip("'\"")
    if not bare:
        return None
    path = Path(bare).expanduser()
    is_beside = path.suffix.lower() in CALIBRATIONS and (images / path).is_file()
    return images / path if is_beside and not path.exists() else path


def _with_rig(
    options: ImportOptions, path: Path, cameras: Sequence[dict[str, Any]]
) -> tuple[ImportOptions, Rig]:
    if path.suffix.lower() == ".toml":
        rig = _rig(options, path, cameras)
        return replace(options, rig=path, calibration=None), rig
    return _with_calibration(options, path, cameras)


def _rig(options: ImportOptions, path: Path, cameras: Sequence[dict[str, Any]]) -> Rig:
    """Read a rig file; refuse one of other cameras."""
    rig = read_rig(path)
    known = {camera.name: (camera.n_cols, camera.n_rows) for camera in rig.cameras}
    for camera in cameras:
        size = require_images(options.images, camera)
        if known.get(camera["name"]) != size:
            found = ", ".join(f"'{name}' of {w} x {h}" for name, (w, h) in known.items())
            raise RigError(
                f"{path}: expected a camera '{camera['name']}' of {size[0]} x {size[1]} pixels as "
                f"in the recording, found {found}. Name another file, or begin again with the "
                "names of this one"
            )
    return rig


def _with_calibration(
    options: ImportOptions, path: Path, cameras: Sequence[dict[str, Any]]
) -> tuple[ImportOptions, Rig]:
    require_writable(options.rig_out, overwrite=options.overwrite, inputs=(path,))
    # Any size will do to find out whether the matrices can be read.
    size = parse_size(options.projector_size) if options.projector_size else (1, 1)

    def read(keys: str) -> Rig:
        return read_calibration(
            path,
            images=options.images,
            cameras=cameras,
            projector_size=size,
            keys=parse_keys(keys) if keys else None,
            inverse_pose=options.inverse_pose,
        )

    keys = options.calibration_keys or ""
    if not keys and not has_known_keys(path):
        _tell(f"{path} holds {', '.join(matrix_names(path))}.\n{KEYS_HELP}")
        keys = _ask("Names of the matrices", lambda answer: answer and read(answer))
    return replace(options, rig=None, calibration=path, calibration_keys=keys or None), read(keys)


def _ask_projector_size(rig: Rig | None) -> str | None:
    needed = rig is not None and rig.projector is not None
    question = "Projector size, WIDTHxHEIGHT" + ("" if needed else " (Enter if unknown)")
    return _ask(question, lambda answer: (answer or needed) and parse_size(answer)) or None


def _ask_depth(camera: str) -> str | None:
    question = f"Depth range MIN:MAX, mm from {camera} (Enter for none)"
    return _ask(question, lambda answer: answer and parse_depth(answer)) or None


def _tell(text: str) -> None:
    print(text, file=sys.stderr)  # noqa: T201


def _ask(question: str, check: Callable[[str], object], /, *, default: str = "") -> str:
    """Ask until the answer passes the check; say each time why it does not."""
    prompt = f"{question} [{default}]: " if default else f"{question}: "
    while True:
        try:
            answer = _line(prompt) or default
            check(answer)
        except Fringe3DError as problem:
            fail(str(problem))
        else:
            return answer


def _line(prompt: str) -> str:
    """Return one line from the terminal, without the blanks around it."""
    try:
        if not sys.stdout.isatty():  # the result goes into a file, the question does not
            print(prompt, end="", file=sys.stderr, flush=True)  # noqa: T201
            prompt = ""
        text = input(prompt).expandtabs(1).strip()
    except (EOFError, KeyboardInterrupt):
        _tell("")  # what follows begins on its own line
        raise
    except UnicodeError as problem:
        raise PlanError(f"import: expected text, found {problem}. Type it again") from None
    if not text.isprintable():
        raise PlanError(
            "import: expected letters, digits and signs, found something else between them: "
            f"{text!a}. Type it again"
        )
    return text


def _command(options: ImportOptions) -> str:
    """Return the command line that says the same."""
    given: list[tuple[str, object]] = [
        ("--out", options.out if options.out != options.images / "scan.toml" else None),
        *(("--camera", text) for text in options.cameras),
        *(("--sequence", text) for text in options.sequence),
        ("--bit-depth", options.bit_depth),
        ("--rig", options.rig),
        ("--calibration", options.calibration),
        ("--calibration-keys", options.calibration_keys),
        ("--projector-size", options.projector_size),
        ("--depth", options.depth),
        ("--black-level", options.black_level or None),
        ("--title", options.title or None),
    ]
    words = ["fringe3d", "import", str(options.images)]
    words += [word for name, value in given if value is not None for word in (name, str(value))]
    words += ["--inverse-pose"] * options.inverse_pose + ["--overwrite"] * options.overwrite
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)
