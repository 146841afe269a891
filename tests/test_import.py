"""``fringe3d import`` asks or takes options, writes what was said, and checks it.

The recording is that of the other tests, written as another program would; the oracle is the
measurement with the rig and the plan that made it. The tests drive the dialogue; they do not
prove that its words are understood.
"""

from __future__ import annotations

import math
import os
import re
import select
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from closed_form import Recording
from fringe3d.cli import main
from fringe3d.cli.importer import direction_that_fits
from fringe3d.errors import OutputError
from fringe3d.io.atomic import write_text
from fringe3d.io.images import write_png
from fringe3d.io.importing import count_images, guess_cameras, parse_camera
from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import read_rig, rig_text
from fringe3d.io.scanfile import read_scan_table
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import Device, Rig, RigidTransform, Scan
from fringe3d.pipeline import MeasureOptions, measure

TypeIn = Callable[..., None]

FRINGES, CODE = "fringes period_px=16 n_shifts=4", "gray cell_px=8 n_bits=7"
CAMERAS = ("--camera", "c1=left/shot{index}.png@1", "--camera", "c2=right/shot{index}.png@1")
SEQUENCE = ("--sequence", FRINGES, "--sequence", CODE)
DESCRIBED = ("import", "images", *CAMERAS, *SEQUENCE)
ONE_CAMERA = ("import", "images", "--camera", "c1={index}.png",
              "--sequence", "light", "--sequence", "dark")  # fmt: skip
KEYS = ("M1", "D1", "M2", "D2", "R", "T")
OTHER_KEYS = ("K_left", "k_left", "K_right", "k_right", "rotation", "translation")

PROMPT_S = 60.0
"""The first question waits for the libraries; a slow machine needs some of it."""


# -------------------------------------------------------------------- recordings of other software


@pytest.fixture
def images(recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return ``images`` in the working directory: two cameras, numbers from 1; a calibration."""
    scan = recording[0]
    assert scan.rig is not None
    folder = tmp_path / "images"
    write_scan(folder, replace(scan, rig=None))
    (folder / "scan.toml").unlink()
    for theirs, name in zip(scan.stacks, ("left", "right"), strict=True):
        (folder / theirs.device_name).rename(folder / name)
        for index in range(len(theirs.images))[::-1]:
            file = folder / name / f"{index:03d}.png"
            file.rename(folder / name / f"shot{index + 1}.png")
    write_calibration(scan.rig.cameras, tmp_path / "stereo.yml")
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return ``images`` in the working directory, two grey ones; what they say is not checked."""
    fill(tmp_path / "images", np.full((6, 8), 200, np.uint8))
    for check in ("_check", "_check_both_directions"):
        monkeypatch.setattr(f"fringe3d.cli.importer.{check}", lambda *_: ("not checked", {}))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "images"


def fill(folder: Path, image: np.ndarray, *names: str) -> None:
    """Write one image under several names."""
    folder.mkdir(exist_ok=True)
    for name in names or ("0.png", "1.png"):
        write_png(folder / name, image)


def write_calibration(devices: Sequence[Device], path: Path, keys: Sequence[str] = KEYS) -> None:
    """Write a pair of devices as OpenCV would: X_second = R X_first + T."""
    first, second = devices
    pose = second_from_first(devices)
    values = (
        first.camera_matrix, first.distortion[:5].reshape(1, 5),
        second.camera_matrix, second.distortion[:5].reshape(1, 5),
        pose.rotation, pose.translation.reshape(3, 1),
    )  # fmt: skip
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in zip(keys, values, strict=True):
        storage.write(key, value)
    storage.release()


def second_from_first(devices: Sequence[Device]) -> RigidTransform:
    """Return the pose of the second device in the frame of the first."""
    first, second = devices
    return second.device_from_world @ first.device_from_world.inverse()


def small_rig(rig: Rig) -> Rig:
    """Return the rig with a first camera that has the size of the small images."""
    first, second = rig.cameras
    small = replace(first, n_rows=6, n_cols=8)
    return Rig(cameras=(small, second), projector=rig.projector)


@pytest.fixture
def type_in(monkeypatch: pytest.MonkeyPatch) -> TypeIn:
    """Return a function that answers the questions to come; then the input ends."""

    def install(*answers: str | BaseException) -> None:
        waiting = list(answers)

        def line(_prompt: str) -> str:
            answer = waiting.pop(0) if waiting else EOFError()
            if isinstance(answer, BaseException):
                raise answer
            return answer

        monkeypatch.setattr("builtins.input", line)
        monkeypatch.setattr("sys.stdin.isatty", lambda: True)

    return install


def failure(arguments: Sequence[str], *, exit_code: int = 2) -> None:
    """Require that a command fails with the exit code."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    assert exit_code == stop.value.code


# ------------------------------------------------------------------------------ on a real terminal


def converse(arguments: Sequence[str], talk: Sequence[tuple[str, str]]) -> tuple[int, str]:
    """Run the command on a pseudo terminal; give each answer when its question stands there."""
    pty = pytest.importorskip("pty", reason="pty: the system has no pseudo terminals")
    terminal, end = pty.openpty()
    command = [sys.executable, "-m", "fringe3d", *arguments]
    # A terminal without abilities: no control sequences among the words.
    process = subprocess.Popen(
        command, stdin=end, stdout=end, stderr=end, env=os.environ | {"TERM": "dumb"}
    )
    os.close(end)
    try:
        said = ""
        for question, answer in talk:
            heard = ""
            while not heard.rstrip(" ").endswith(question):
                heard += read_some(terminal)
            said += heard
            os.write(terminal, answer.encode())
        while part := read_some(terminal):
            said += part
        return process.wait(PROMPT_S), said.replace("\r\n", "\n")
    finally:
        process.kill()
        process.wait()
        os.close(terminal)


def read_some(terminal: int) -> str:
    """Return what the terminal shows next, nothing where its other end is closed."""
    ready, _, _ = select.select([terminal], [], [], PROMPT_S)
    assert ready, "expected a question or the end, found silence"
    try:
        return os.read(terminal, 65536).decode()
    except OSError:
        return ""


def test_dialogue_on_a_terminal_gives_the_points_of_a_direct_measurement(
    images: Path, recording: Recording
) -> None:
    code, said = converse(
        ["import", "images"],
        [
            ("Camera 1 [c1=left/shot{index}.png@1]:", "\n"),
            ("Camera 2 [c2=right/shot{index}.png@1]:", "c2=right/{index}.png\n"),
            ("Camera 2 [c2=right/shot{index}.png@1]:", "\n"),
            ("Images 1 (11 left):", "fringes 16\n"),
            ("Images 1 (11 left):", f"{FRINGES}\n"),
            ("Images 2 (7 left):", f"{CODE}\n"),
            ("Images 3 (complete):", "\n"),
            ("Bit depth [8]:", "twelve\n"),
            ("Bit depth [8]:", "\n"),
            ("Calibration or rig:", "elsewhere.yml\n"),
            ("Calibration or rig:", "stereo.yml\n"),
            ("Projector size, WIDTHxHEIGHT (Enter if unknown):", "1024\n"),
            ("Projector size, WIDTHxHEIGHT (Enter if unknown):", "1024x768\n"),
            ("Depth range MIN:MAX, mm from c1 (Enter for none):", "370:310\n"),
            ("Depth range MIN:MAX, mm from c1 (Enter for none):", "310:370\n"),
        ],
    )
    assert code == 0, said
    assert "by method m1" in said
    assert said.count("error: ") == 6
    assert "Traceback" not in said
    _require_points_of(recording[0], read_scan(images))


def _require_points_of(direct: Scan, imported: Scan) -> None:
    """Require the same points, in the frame of C1, where both measurements have one."""
    assert direct.rig is not None
    depth = MeasureOptions(depth_mm=(310.0, 370.0))
    wanted, found = measure(direct, depth).points, measure(imported, MeasureOptions()).points
    assert wanted is not None
    assert found is not None
    c1_from_world = direct.rig.cameras[0].device_from_world
    both = wanted.is_valid & found.is_valid
    # With its projector the direct measurement knows the edge of the pattern.
    assert 0.99 * wanted.is_valid.sum() < both.sum()
    expected = c1_from_world.apply(wanted.points_mm[both])
    # The file rounds matrices to 16 digits. With its projector the direct measurement looks near a
    # light sheet, the other along the whole curve: where a phase bends within a pixel of C2 they
    # may end a hundredth of a pixel apart.
    off = np.linalg.norm(found.points_mm[both] - expected, axis=1)
    assert (off < 1e-6).mean() > 0.9999
    assert off.max() < 0.01


def test_end_of_input_at_a_question_is_said_clearly(small: Path) -> None:
    code, said = converse(["import", "images"], [("Camera 1 [c1={index}.png@0]:", "\x04")])
    assert code == 2
    assert "error: import: expected an answer, found the end of the input (Ctrl-D)" in said
    assert {"0.png", "1.png"} == {path.name for path in small.iterdir()}


@pytest.mark.parametrize("n_answers", range(7))
def test_interrupt_or_end_at_any_question_leaves_nothing_behind(
    n_answers: int,
    small: Path,
    rig: Rig,
    type_in: TypeIn,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_calibration(small_rig(rig).cameras, Path("stereo.yml"))
    answers = ["", "c2={index}.png", "unused count=2", "", "", "stereo.yml", "1024x768"]
    type_in(*answers[:n_answers], KeyboardInterrupt())
    failure(["import", "images"], exit_code=130)
    assert "error: interrupted; nothing was written" in capsys.readouterr().err
    type_in(*answers[:n_answers])
    failure(["import", "images"])
    assert "nothing was written. Begin again" in capsys.readouterr().err
    assert {"0.png", "1.png"} == {path.name for path in small.iterdir()}


def test_a_calibration_beside_the_images_is_found_by_its_name(
    small: Path, rig: Rig, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    """After the question that follows the one for it, Ctrl-C: the file was read."""
    write_calibration(small_rig(rig).cameras, small / "stereo.yml")
    type_in("", "c2={index}.png", "unused count=2", "", "", "stereo.yml", KeyboardInterrupt())
    failure(["import", "images"], exit_code=130)
    assert "expected a calibration file" not in capsys.readouterr().err
    (small / "stereo.yml").unlink()
    type_in("", "c2={index}.png", "unused count=2", "", "", "stereo.yml", KeyboardInterrupt())
    failure(["import", "images"], exit_code=130)
    assert "stereo.yml: expected a calibration file, found none" in capsys.readouterr().err


# ----------------------------------------------------------------------------- the single questions


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        (["c1", "", "", "unused count=2", "", "", "", ""], "--camera: expected NAME=PATTERN"),
        (
            ["c1={index}.png@one", "", "", "unused count=2", "", "", "", ""],
            "expected a whole number, that of the first image, behind the @, found 'one'",
        ),
        (
            ["c1={index.x}.png", "", "", "unused count=2", "", "", "", ""],
            "expected a path with {index} or {index:02d} for the number",
        ),
        (
            ["c1={index}.bmp", "", "", "unused count=2", "", "", "", ""],
            "expected images of this pattern in images, found none",
        ),
        (
            ["c1={index}.png@7", "", "", "unused count=2", "", "", "", ""],
            "expected image 7 to be the first, found the numbers 0 to 1. Give the first as c1=",
        ),
        (
            ["-", "", "c1={index}.png", "", "unused count=2", "", "", "", ""],
            "--camera: expected at least one camera, found none",
        ),
        (
            ["", "c1={index}.png", "", "unused count=2", "", "", "", ""],
            "expected another name, found that of an earlier camera",
        ),
        (["", "", "grey", "unused count=2", "", "", "", ""], "expected one of the kinds fringes, "),
        (
            ["", "", "fringes period_px=-1 n_shifts=4", "unused count=2", "", "", "", ""],
            "period_px: expected a number ",
        ),
        (
            ["", "", "gray cel_px=8 n_bits=2", "unused count=2", "", "", "", ""],
            "unknown key 'cel_px'. Did you mean 'cell_px'?",
        ),
        (
            ["", "", "light", "", "-", "unused count=2", "", "", "", ""],
            "expected 2 images, as camera 'c1' has, found 1. Name the rest (or: unused count=1)",
        ),
        (
            ["", "", "unused count=3", "", "-", "unused count=2", "", "", "", ""],
            "expected 2 images, as camera 'c1' has, found 3. Take one back",
        ),
        (["", "", "unused count=2", "", "0", "8", "", ""], "--bit-depth: expected 8, found '0'"),
        (["", "", "unused count=2", "", "\x1b[A", "8", "", ""], "found something else between"),
        (
            ["", "", "unused count=2", "", "", "0.png", "", ""],
            "0.png: expected a calibration file, found none. Check the path",
        ),
        (
            ["", "", "unused count=2", "", "", "images/0.png", "", ""],
            "0.png: expected OpenCV YAML, XML or JSON, found something else",
        ),
        (["", "", "unused count=2", "", "", "rig.toml", "", ""], "rig.toml: expected a file"),
        (
            ["", "", "unused count=2", "", "", "", "0x0", "1024x768"],
            "--projector-size: expected WIDTHxHEIGHT in pixels, as 1024x768, found '0x0'",
        ),
    ],
)
def test_wrong_answer_is_explained_and_asked_again(
    answers: list[str],
    said: str,
    small: Path,
    type_in: TypeIn,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The earlier answers stay: in the end the file is the one of right answers alone."""
    type_in(*answers)
    main(["import", "images"])
    error = capsys.readouterr().err
    assert said in error
    assert error.count("error: ") == 1
    table = read_scan_table(small / "scan.toml")
    assert table.cameras[0].images == "{index}.png"
    assert table.plan().n_images == 2


@pytest.mark.parametrize(
    ("brightest", "bits"), [(200, 10), (1023, 10), (1024, 12), (4095, 12), (9000, 14), (60000, 16)]
)
def test_bit_depth_of_16_bit_files_is_the_smallest_that_holds_the_brightest_value(
    brightest: int, bits: int, small: Path, type_in: TypeIn
) -> None:
    fill(small, np.full((6, 8), brightest, np.uint16))
    type_in("", "", "unused count=2", "", "", "", "")
    main(["import", "images"])
    assert bits == read_scan_table(small / "scan.toml").bit_depth


def test_bit_depth_too_small_for_the_files_is_asked_again(
    small: Path, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    fill(small, np.full((6, 8), 4000, np.uint16))
    type_in("", "", "unused count=2", "", "10", "14", "", "")
    main(["import", "images"])
    message = "--bit-depth: expected 12 to 16 (the brightest grey value is 4000), found '10'"
    assert message in capsys.readouterr().err
    assert read_scan_table(small / "scan.toml").bit_depth == 14


def test_names_of_matrices_are_asked_where_they_are_unknown(
    small: Path, rig: Rig, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a projector as second device its size must be said."""
    assert rig.projector is not None
    devices = (small_rig(rig).cameras[0], rig.projector)
    write_calibration(devices, Path("odd calibration.yml"), OTHER_KEYS)
    named = f"{','.join(OTHER_KEYS)}:projector"
    path = "'odd calibration.yml'"
    wrong = ["K_left", "", path, named.replace("K_left", "K_lost")]
    type_in("", "", "unused count=2", "", "", path, *wrong, named, "", "1024x768", "-9:-1", "")
    main(["import", "images"])
    error = capsys.readouterr().err
    assert "odd calibration.yml holds K_left, K_right, k_left, k_right, rotation, trans" in error
    assert "--calibration-keys: expected M1,D1,M2,D2,R,T and optionally :projector, fou" in error
    assert "expected one of the known sets of matrices" in error
    assert "expected a matrix 'K_lost', found none" in error
    assert "--projector-size: expected WIDTHxHEIGHT in pixels, as 1024x768, found ''" in error
    assert "--depth: expected MIN:MAX in mm, finite, MIN below MAX and MAX above 0" in error
    written = read_rig(small / "rig.toml")
    assert written.projector is not None
    assert written.projector.shape == (768, 1024)
    expected = second_from_first(devices)
    np.testing.assert_allclose(
        written.projector.device_from_world.translation, expected.translation, atol=1e-9
    )


def test_rig_file_is_told_by_its_suffix_and_must_fit_the_cameras(
    small: Path, rig: Rig, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    """A rig knows its projector and its volume: neither is asked."""
    Path("big.toml").write_text(rig_text(rig), encoding="utf-8")
    Path("rig.toml").write_text(rig_text(small_rig(rig)), encoding="utf-8")
    type_in("", "", "unused count=2", "", "", "big.toml", "rig.toml")
    main(["import", "images"])
    error = capsys.readouterr().err
    assert "big.toml: expected a camera 'c1' of 8 x 6 pixels as in the recording" in error
    assert read_scan_table(small / "scan.toml").rig == "../rig.toml"


def test_wrong_calibration_among_the_options_is_asked_for_and_the_answers_stay(
    small: Path, rig: Rig, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    write_calibration(rig.cameras, Path("stereo.yml"))
    Path("rig.toml").write_text(rig_text(small_rig(rig)), encoding="utf-8")
    type_in("", "", "unused count=2", "", "", "rig.toml")
    main(["import", "images", "--calibration", "stereo.yml", "--depth", "310:370"])
    error = capsys.readouterr().err
    assert "stereo.yml: holds two cameras, but the recording has one" in error
    assert "Left out, as no calibration is imported: --depth" in error
    assert read_scan_table(small / "scan.toml").rig == "../rig.toml"


@pytest.mark.usefixtures("small")
def test_printed_command_says_the_same_without_questions(
    rig: Rig, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    write_calibration(small_rig(rig).cameras, Path("stereo.yml"), OTHER_KEYS)
    keys = ",".join(OTHER_KEYS)
    type_in("", "c2={index}.png", "light", "dark", "", "", "stereo.yml", keys, "", "310:370")
    main(["import", "images", "--out", "a scan.toml", "--title", "two words", "--inverse-pose"])
    command = capsys.readouterr().err.split("The same without questions:\n")[1]
    before = [Path(name).read_bytes() for name in ("a scan.toml", "a scan-rig.toml")]
    type_in()
    main([*shlex.split(command)[1:], "--overwrite"])
    assert before == [Path(name).read_bytes() for name in ("a scan.toml", "a scan-rig.toml")]


# ------------------------------------------------------------------------------ nothing to be asked


def test_import_describes_a_recording_of_other_software(
    images: Path, recording: Recording, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cameras and sequence are all that is needed: even on a terminal no question comes."""
    type_in()
    main([*DESCRIBED, "--projector-size", "1024x768", "--calibration", "stereo.yml",
          "--depth", "310:370"])  # fmt: skip
    printed = capsys.readouterr()
    assert "by method m1" in printed.out
    assert "texture of both cameras agrees" in printed.out
    assert printed.err == ""
    _require_points_of(recording[0], read_scan(images))
    main(["measure", "images", "--out", "result"])
    assert Path("result/cloud.ply").is_file()


def test_import_finds_in_which_direction_r_and_t_map(
    images: Path, recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file whose R and T map the second camera to the first, and nobody says so."""
    rig = recording[0].rig
    assert rig is not None
    pose = second_from_first(rig.cameras)
    turned = (rig.cameras[0], replace(rig.cameras[1], device_from_world=pose.inverse()))
    origin = replace(rig.cameras[0], device_from_world=RigidTransform.identity())
    write_calibration((origin, turned[1]), Path("stereo.yml"))
    main([*DESCRIBED, "--calibration", "stereo.yml", "--depth", "310:370"])
    printed = capsys.readouterr()
    assert "(--inverse-pose): so they fit the images better" in printed.out
    found = read_scan(images).rig
    assert found is not None
    np.testing.assert_allclose(
        second_from_first(found.cameras).translation, pose.translation, atol=1e-9
    )


@pytest.mark.parametrize(("points", "texture", "expected", "why"), [
    ((70_000, 71_000), (0.77, 0.91), True, "texture 0.77 as OpenCV's, 0.91 the other way"),
    ((70_000, 71_000), (0.91, 0.77), False, "texture 0.91"),
    ((70_000, 60_000), (0.77, 0.91), True, "texture"),  # it is at the points themselves
    ((70_000, 71_000), (0.90, 0.91), None, "70,000 points as OpenCV's"),
    ((70_000, 71_000), (math.nan, 0.9), None, "points"),
    ((70_000, 80_000), (math.nan, math.nan), True, "points"),
    ((70_000, 60_000), (math.nan, math.nan), False, "points"),
    ((70_000, 0), (0.5, 0.9), False, "points"),  # what other checks contradict does not count
    ((0, 70_000), (math.nan, 0.9), True, "points"),
])  # fmt: skip
def test_texture_decides_between_directions_that_fit(
    points: tuple[int, int], texture: tuple[float, float], expected: bool | None, why: str
) -> None:
    is_inverse, told = direction_that_fits(points, texture)
    assert is_inverse is expected
    assert why in told


def test_import_names_what_may_mend_a_pose_that_contradicts_the_images(
    images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failure([*DESCRIBED, "--calibration", "stereo.yml", "--inverse-pose"])
    message = " ".join(capsys.readouterr().err.split())
    assert "images/scan.toml is written, but the check failed: " in message
    assert "import again without --inverse-pose, and with --overwrite" in message
    assert ".." not in message
    assert (images / "scan.toml").is_file()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((), r"--camera NAME=PATTERN is needed where nobody can be asked .*found c1={index}.png@0"),
        (("--camera", "c1={index}.png"), r"--sequence 'KIND KEY=VALUE \.\.\.' is needed where"),
    ],
)
def test_where_nobody_can_be_asked_the_needed_options_are_named(
    given: tuple[str, ...], said: str, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failure(["import", "images", *given])
    assert re.search(said, capsys.readouterr().err)
    assert not (small / "scan.toml").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--depth", "310:370"), "--depth: expected --calibration beside it, found none"),
        (("--depth", "310"), "--depth: expected MIN:MAX in mm.*, found '310'"),
        (("--inverse-pose",), "--inverse-pose: expected --calibration beside it, found none"),
        (("--bit-depth", "99"), "--bit-depth: expected 8 to 16, found '99'"),
        (("--bit-depth", "many"), '--bit-depth: unable to convert "many"'),
        (("--projector-size", "big"), "--projector-size: expected WIDTHxHEIGHT.*, found 'big'"),
        (("--black-level", "-1"), "--black-level: expected a grey value >= 0, found -1"),
        (("--black-level", "300"), r"expected black_level_dn < saturation_dn <= 255"),
        (("--rig", "rig.toml"), "rig.toml: expected a file, found none"),
        (("--calibration", "no.yml"), "no.yml: expected a calibration file, found none"),
        (("--calibration-keys", "M1,D1"), "--calibration-keys: expected M1,D1,M2,.*'M1,D1'"),
        (("--camera", "c1={index}.png"), "--camera: expected different names, found c1, c1"),
        (("--camera", "c2={index}.bmp"), "expected images of this pattern in images, found none"),
        (("--sequence", "light now"), "--sequence 'light now': expected KIND KEY=VALUE"),
        (("--sequence", "unused count=1 count=2"), "expected 'count' once, found it again"),
    ],
)
def test_wrong_option_ends_in_one_message_before_anything_is_asked_or_written(
    given: tuple[str, ...], said: str, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failure([*ONE_CAMERA, *given])
    message = capsys.readouterr().err
    assert re.search(said, message)
    assert message.count("\n") == 1
    assert {"0.png", "1.png"} == {path.name for path in small.iterdir()}


# ------------------------------------------------------------------------------ what it writes over


@pytest.fixture
def calibrated(small: Path, rig: Rig) -> list[str]:
    """Return a command that writes a scan file and a rig file for the small images."""
    write_calibration(small_rig(rig).cameras, Path("stereo.yml"))
    assert small.is_dir()
    return [*ONE_CAMERA, "--camera", "c2={index}.png", "--calibration", "stereo.yml"]


def test_converted_calibration_never_replaces_a_rig_unasked(
    calibrated: list[str], small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (small / "rig.toml").write_text("mine", encoding="utf-8")
    failure(calibrated)
    assert "images/rig.toml: expected a path that does not exist yet" in capsys.readouterr().err
    assert not (small / "scan.toml").exists()
    assert (small / "rig.toml").read_text(encoding="utf-8") == "mine"
    main([*calibrated, "--out", "images/left.toml"])
    assert read_scan_table(small / "left.toml").rig == "left-rig.toml"
    assert (small / "rig.toml").read_text(encoding="utf-8") == "mine"
    main([*calibrated, "--overwrite"])
    assert read_scan_table(small / "scan.toml").rig == "rig.toml"
    assert (small / "rig.toml").read_bytes() == (small / "left-rig.toml").read_bytes()


def test_existing_rig_is_said_when_the_calibration_is_named(
    calibrated: list[str], small: Path, type_in: TypeIn, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rig that stands in the way may be the one to use."""
    main([*calibrated, "--out", "images/rig.toml"])
    (small / "rig-rig.toml").rename(small / "rig.toml")
    type_in("", "c2={index}.png", "unused count=2", "", "", "stereo.yml", "images/rig.toml", "")
    main(["import", "images"])
    assert "images/rig.toml: expected a path that does not exist" in capsys.readouterr().err
    assert read_scan_table(small / "scan.toml").rig == "rig.toml"


@pytest.mark.parametrize("had_rig", [False, True])
def test_rig_file_stays_as_it_was_when_the_scan_file_cannot_be_written(
    had_rig: bool, calibrated: list[str], small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if had_rig:
        (small / "rig.toml").write_text("mine", encoding="utf-8")

    def write(target: Path, text: str, *, overwrite: bool) -> None:
        if target.name == "scan.toml":
            raise OutputError("full")
        write_text(target, text, overwrite=overwrite)

    monkeypatch.setattr("fringe3d.cli.importer.write_text", write)
    failure([*calibrated, "--overwrite"])
    assert not (small / "scan.toml").exists()
    assert had_rig == (small / "rig.toml").is_file()
    assert not had_rig or (small / "rig.toml").read_text(encoding="utf-8") == "mine"


def test_interrupted_check_says_that_the_file_is_written(
    images: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("fringe3d.cli.importer.measure", stop)
    failure(DESCRIBED, exit_code=130)
    assert "interrupted; images/scan.toml is written but not checked" in capsys.readouterr().err
    assert (images / "scan.toml").is_file()


# ------------------------------------------------------------------------------------ the proposals


def test_two_cameras_in_one_folder_are_both_proposed(tmp_path: Path) -> None:
    grey = np.zeros((2, 2), np.uint8)
    fill(tmp_path, grey, "left08.png", "left09.png", "left10.png", "overview1.png")
    fill(tmp_path, grey, "right_1.png", "right_2.png", "right_10.png", "notes1.txt.png")
    assert guess_cameras(tmp_path) == ["c1=left{index:02d}.png@8", "c2=right_{index}.png@1"]


def test_at_sign_within_a_name_is_no_first_number() -> None:
    entry = parse_camera("c1=img@2x{index}.png@3")
    assert entry == {"name": "c1", "images": "img@2x{index}.png", "first_index": 3}
    assert "first_index" not in parse_camera("c1=img@2x/{index}.png")


def test_images_are_counted_as_the_sequence_projects_them() -> None:
    assert count_images([FRINGES, "gray cell_px=8 n_bits=7 inverses=after", "unused count=3"]) == 21
    assert count_images(["gray cell_px=8 n_bits=7 bits=3", "dark"]) == 2
