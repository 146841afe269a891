"""The commands that README and docs print, carried out as printed.

Each page has a folder of its own.

    python -m benchmarks.docs_commands                    all pages: half an hour
    python -m benchmarks.docs_commands README howto-look  some of them

What a command names and no earlier command of the page has left (`SCAN`, `result`, `rig.toml`, ...)
is made first, as small as it may be: see `MAKERS`. What the docs call FOLDER are the recordings by
others, from FRINGE3D_DATA. Cameras and projector at 127.0.0.1 are those of `fringe3d lab`, started
for the time of the command; other addresses need hardware. Commands with "..." are no whole ones,
nor are those that lack what they need: the text mentions them.
Prints a line for each, "-" with the reason for what was not carried out; the exit code is the
number of commands that failed.
"""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import MissingArgumentError

from fringe3d.cli import main as fringe3d
from fringe3d.cli.app import app

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from test_docs import PAGES, commands  # noqa: E402

if TYPE_CHECKING:
    import trimesh

SIZE = "--camera-size 320x256"
SMALL = "--camera-size 320x256 --rays 1 --period 32"
SCENE = f"simulate kolibri {SMALL} --plan m0 --steps 8"
BOARDS = "simulate kolibri --camera-size 640x512 --rays 1 --period 32 --positions 8"
TURNS = f"simulate kolibri {SIZE} --object machine-part --plan m2 --positions 6"
OWN = f"simulate kolibri {SIZE} --rays 1 --plan m1 --steps 4"
"""What docs/howto-own-images.md takes as recorded by another program."""

MAKERS = {
    "SCAN": f"{SCENE} --out SCAN",
    "scan": f"{SCENE} --out scan",
    "OTHER": f"{SCENE} --object teeth --out OTHER",
    "other-scan": f"{SCENE} --object teeth --out other-scan",
    "any-scan-of-these-cameras": f"{SCENE} --object teeth --out any-scan-of-these-cameras",
    "scan-a": f"{SCENE} --seed 1 --out scan-a",
    "scan-b": f"{SCENE} --seed 2 --out scan-b",
    "ball-1": f"{SCENE} --object sphere --out ball-1",
    "ball-bar": f"{SCENE} --object bar.stl --out ball-bar",
    "bar.stl": "",
    "flat-plate": f"{SCENE} --object flat-plate --out flat-plate",
    "ball.stl": "",
    "turns": f"{SCENE} --object ball.stl --positions 3 --out turns",
    "r0": "measure turns/000 --out r0",
    "r1": "measure turns/001 --out r1",
    "r2": "measure turns/002 --out r2",
    "r3": "measure ball-bar --out r3",
    "r4": "measure flat-plate --out r4",
    "IMAGES": f"{SCENE} --out IMAGES",
    "demo/result": "demo",
    "my-images": "",
    "poses": f"{BOARDS} --object chessboard:9x7:6mm --out poses",
    "SCANS": f"{TURNS} --out SCANS",
    "scans": f"{TURNS} --out scans",
    "body": "merge scans --out body",
    "BOARD-IMAGES": f"{BOARDS} --object chessboard:9x6:6mm --out BOARD-IMAGES",
    "result": "measure SCAN --out result",
    "RESULT": "measure SCAN --out RESULT",
    "full": "measure SCAN --out full",
    "reduced": "measure SCAN --gray-bits 3 --out reduced",
    "four": "measure SCAN --gray-bits 0 --direction x --out four",
    "OTHER.ply": "measure OTHER --out other-result",
    "other.ply": "measure OTHER --out other-result",
    "design": "design kolibri --out design",
    "accepted": "evaluate acceptance --ball r1 --diameter 20.003 --out accepted",
    "compared": "evaluate compare result OTHER.ply --out compared",
    "patterns/plan.toml": "patterns --size 1024x768 --period 32 --steps 4 --out patterns",
    "rig.toml": "",
    "rig-with-bias.toml": "calibrate bias --from SCAN --out rig-with-bias.toml",
    "cameras.toml": "",
    "moved.toml": "",
    "stereo.yml": "export rig.toml --out stereo.yml",
    "kolibri.toml": "",
    "plan.toml": "patterns --size 1024x768 --period 16 --steps 4 --gray-bits 3 --out plan",
    "LARGE": f"simulate kolibri {SMALL} --object plane --plan m1 --steps 4 --out LARGE",
    "part.stl": "",
}
"""What makes a thing that commands name; nothing where `made` does it."""

ENDLESS = ("view", "lab")
ENDLESS_S = 60.0
"""So long a view may take to end."""

DESCRIBED = "kept-scan.toml"
"""The description of images that a command is to describe."""

DATA = {
    "slmaster-relief": "",
    "slmaster-bust-rendered": "slmaster-bust-rendered",
    "procam-board": "procam-board",
    "chessboard:9x7": "procam-board",
}
"""Folders of FRINGE3D_DATA that the pages call FOLDER, by a word of the command."""

LONG = {"README": ("evaluate", "paper")}
"""Commands that another page carries out, and that take minutes."""


def main() -> int:
    """Run the commands of the pages named; return how many failed."""
    wanted = sys.argv[1:]
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for page in PAGES:
            if wanted and page.stem not in wanted:
                continue
            place = Path(folder) / page.stem
            place.mkdir()
            shutil.copytree(ROOT / "examples", place / "examples")
            with contextlib.chdir(place):
                failed += run_page(page, Path(folder) / "made")
    return failed


def run_page(page: Path, made: Path) -> int:
    """Run the commands of one page, in order; return how many failed."""
    failed = 0
    for command, is_whole in commands(page):
        words = shlex.split(command, comments=True)[1:]
        begin = time.perf_counter()
        try:
            require_whole(command, words, is_whole=is_whole)
            if tuple(words[:2]) == LONG.get(page.stem):
                raise MissingError("long; docs/paper.md carries it out")
            prepare(words, page, made)
            code, said = carried_out(words)
        except MissingError as problem:
            print(f"-      {page.stem}: {command}: {problem}", flush=True)
            continue
        seconds = time.perf_counter() - begin
        # 1: the doctor found something, a limit of an acceptance test was broken.
        is_fine = code == 0 or (code == 1 and words[0] in ("doctor", "evaluate"))
        failed += not is_fine
        print(f"{'ok' if is_fine else 'FAILED':6s} {seconds:6.1f} s  {page.stem}: {command}",
              flush=True)  # fmt: skip
        if not is_fine:
            print("       " + said.strip()[-600:].replace("\n", "\n       "), flush=True)
    return failed


def require_whole(command: str, words: list[str], *, is_whole: bool) -> None:
    """Refuse what is only mentioned."""
    if "..." in command:
        raise MissingError("no whole command")
    if not is_whole and len(words) == 1 and words[0] not in ("devices", "demo"):
        raise MissingError("a name")
    try:
        app.parse_args(words, exit_on_error=False, print_error=False)
    except MissingArgumentError:
        raise MissingError("a mention, without what it needs") from None


class MissingError(Exception):
    """Something that is not here and cannot be made."""


def prepare(words: list[str], page: Path, made: Path) -> None:
    """Make what a command reads and is not there; take away what it is to write."""
    outs = [words[i + 1] for i, word in enumerate(words[:-1]) if word in ("--out", "--html")]
    for out in outs:
        if Path(out).is_dir():
            shutil.rmtree(out)
        else:
            Path(out).unlink(missing_ok=True)
            left = [Path(out).with_suffix(".png")]  # what some leave beside
            for ending in ("md", "png"):
                left += Path(out).parent.glob(f"{Path(out).stem}-*.{ending}")
            for beside in left:
                beside.unlink(missing_ok=True)
    for word in words[1:]:
        name = word.split("=")[-1]  # of NAME=FILE
        if name not in MAKERS:
            name = name.partition("/")[0]  # a scan of several
        if name == "FOLDER" and "--board" in words and "--scan" not in words:
            prepare(["", "poses"], page, made)
            Path("FOLDER").unlink(missing_ok=True)
            Path("FOLDER").symlink_to("poses")
        elif name == "FOLDER":
            recorded_by_others(" ".join(words))
        elif name in MAKERS and name not in outs and not Path(name).exists():
            make(name, page, made)
        if words[0] != "import" and (Path(name) / DESCRIBED).exists():
            described(Path(name))
    if words[0] == "live" and "--video" in words:
        videos()
    if words[0] == "demo":
        shutil.rmtree("demo", ignore_errors=True)
    if words[0] == "report":
        if words[1] == "rig.toml" and not Path("rig-board.md").exists():
            calibrated()
        for written in [*Path(words[1]).glob("report.*"), *Path().glob("*-report.*")]:
            written.unlink()


def recorded_by_others(command: str) -> None:
    """Let FOLDER be the recording that a command is about."""
    data = os.environ.get("FRINGE3D_DATA")
    found = [folder for word, folder in DATA.items() if word in command]
    if data is None or not found:
        raise MissingError("needs FRINGE3D_DATA" if data is None else "whose FOLDER?")
    Path("FOLDER").unlink(missing_ok=True)
    Path("FOLDER").symlink_to(Path(data) / found[0])


def calibrated() -> None:
    """Leave a rig.toml with the report of its calibration beside."""
    Path("rig.toml").unlink(missing_ok=True)
    board = "calibrate FOLDER --scan examples/captures/procam-board.toml --board chessboard:9x7"
    recorded_by_others(board)
    run(shlex.split(f"{board} --out rig.toml"))


def videos() -> None:
    """Make left.avi and right.avi of what the plan shows, as two cameras record it."""
    import cv2

    run(shlex.split(f"simulate kolibri {SIZE} --rays 1 --plan plan.toml --out filmed"))
    for camera, name in (("c1", "left.avi"), ("c2", "right.avi")):
        film = cv2.VideoWriter(name, cv2.VideoWriter_fourcc(*"FFV1"), 30, (320, 256), False)
        for image in sorted(Path("filmed", camera).glob("*.png")):
            film.write(cv2.imread(str(image), cv2.IMREAD_GRAYSCALE))
        film.release()
    shutil.copy("filmed/rig.toml", "rig.toml")


def make(word: str, page: Path, made: Path) -> None:
    """Make a thing; scans are made once for all pages."""
    words = shlex.split(MAKERS[word])
    kept = made / word
    if word == "my-images":
        own_images(Path(word))
        return
    if not kept.exists():
        if words:
            prepare(words, page, made)
            run(words)
        else:
            prepare(["", "SCAN"], page, made)
        for source in special(word):
            shutil.copy(source, word)
        if word == "IMAGES":
            (Path(word) / "scan.toml").rename(Path(word) / DESCRIBED)
        if words[:1] != ["simulate"]:
            return
        made.mkdir(exist_ok=True)
        shutil.move(word, kept)
    shutil.copytree(kept, word)


def run(words: list[str]) -> None:
    """Run a command that makes something."""
    code, said = carried_out(words)
    if code:
        raise MissingError(f"'{' '.join(words)}' failed: {said.strip()[-200:]}")


def own_images(folder: Path) -> None:
    """Make a recording as another program would leave it, and the file of its calibration."""
    run([*shlex.split(OWN), "--out", "own"])
    for camera, side in (("c1", "left"), ("c2", "right")):
        (folder / side).mkdir(parents=True)
        for number in range(1, 12):
            shutil.copy(
                f"own/{camera}/{number - 1:03d}.png", folder / side / f"shot{number:02d}.png"
            )
    run(["export", "own/rig.toml", "--out", "stereo.yml"])


def special(word: str) -> Iterator[str]:
    """Yield the file that stands for a thing that no command of its own makes."""
    if word in ("rig.toml", "cameras.toml", "moved.toml", "kolibri.toml"):
        yield "SCAN/rig.toml"
    if word.lower() == "other.ply":
        yield "other-result/cloud.ply"
    if word == "plan.toml":
        yield "plan/plan.toml"
    if word == "part.stl":
        import trimesh

        trimesh.creation.box((30, 20, 10)).export("box.stl")
        yield "box.stl"
    if word == "ball.stl":
        ball().export("off-axis.stl")
        yield "off-axis.stl"
    if word == "bar.stl":
        bar().export("ball-bar.stl")
        yield "ball-bar.stl"


def ball() -> trimesh.Trimesh:
    """Return the ball of docs/howto-turntable.md, 20.003 mm, beside the axis on a round plate."""
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=5, radius=20.003 / 2)
    made.apply_translation((18.0, 0.0, 13.0))
    plate = trimesh.creation.cylinder(radius=30.0, height=2.0)
    plate.apply_translation((0.0, 0.0, 1.0))
    return trimesh.util.concatenate([made, plate])


def bar() -> trimesh.Trimesh:
    """Return the ball bar of docs/howto-acceptance.md: balls of 20.003 mm, 60.012 mm apart."""
    import trimesh

    from fringe3d.simulate.objects import ball_bar

    made = ball_bar(radius_mm=20.003 / 2, distance_mm=60.012)
    return trimesh.Trimesh(made.vertices_mm, made.faces, process=False)


def carried_out(words: list[str]) -> tuple[int, str]:
    """Run a command here, endless ones and those that ask apart; return exit code and output."""
    told = " ".join(words)
    if "window:" in told or "gige:192" in told:
        raise MissingError("needs cameras and a projector")
    if "gige:127.0.0.1" in told:
        return with_lab(words)
    if (words[0] == "view" and "--html" not in words) or words[0] == "lab":
        return until_it_tells(words)
    if words[0] == "live" and "--video" in words:
        return until_it_tells(words)
    if words[0] == "import" and "--camera" not in words:
        raise MissingError("asks the user; tests/test_import.py answers")
    return here(words)


def here(words: list[str]) -> tuple[int, str]:
    """Run a command in this process."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            fringe3d(words)
        except SystemExit as ended:
            return int(ended.code or 0), said.getvalue()
    return 0, said.getvalue()


def with_lab(words: list[str]) -> tuple[int, str]:
    """Run a command before the cameras and the projector of a simulated lab."""
    lab = [sys.executable, "-m", "fringe3d", "lab", "kolibri", "--object", "teeth"]
    with subprocess.Popen([*lab, *SIZE.split()], stdout=subprocess.PIPE, text=True) as running:
        try:
            assert running.stdout is not None
            running.stdout.readline()
            return here(words)
        finally:
            running.terminate()


def described(images: Path) -> None:
    """Leave what the user's answers would have left."""
    shutil.copy(images / DESCRIBED, images / "scan.toml")


def until_it_tells(words: list[str]) -> tuple[int, str]:
    """Run what does not end until it says that it is there, and end it."""
    command = [sys.executable, "-m", "fringe3d", *words]
    said = ""
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as running:
        assert running.stdout is not None
        for line in running.stdout:
            said += line
            if "Ctrl-C ends it" in line:
                running.terminate()  # as Ctrl-C, which does not reach what runs in the background
                break
        said += running.stdout.read()
        return running.wait(ENDLESS_S), said


if __name__ == "__main__":
    sys.exit(main())
