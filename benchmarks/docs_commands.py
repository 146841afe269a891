"""The commands that README and docs print, carried out as printed.

Each page has a folder of its own.

    python -m benchmarks.docs_commands                    all pages: half an hour
    python -m benchmarks.docs_commands README howto-look  some of them

What a command names and no earlier command of the page has left (`SCAN`, `result`, `rig.toml`, ...)
is made first, as small as it may be: see `MAKERS`. What the docs call FOLDER are the recordings by
others, from FRINGE3D_DATA. Commands with "..." are no whole commands, nor are bare names of them.
Prints a line for each; the exit code is the number of commands that failed.
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

from fringe3d.cli import main as fringe3d

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from test_docs import PAGES, commands  # noqa: E402

SMALL = "--camera-size 320x256 --rays 1 --period 32"
SCENE = f"simulate kolibri {SMALL} --plan m0 --steps 8"
BOARDS = "simulate kolibri --camera-size 640x512 --rays 1 --period 32 --positions 8"
MAKERS = {
    "SCAN": f"{SCENE} --out SCAN",
    "scan": f"{SCENE} --out scan",
    "OTHER": f"{SCENE} --object teeth --out OTHER",
    "other-scan": f"{SCENE} --object teeth --out other-scan",
    "any-scan-of-these-cameras": f"{SCENE} --object teeth --out any-scan-of-these-cameras",
    "scan-a": f"{SCENE} --seed 1 --out scan-a",
    "scan-b": f"{SCENE} --seed 2 --out scan-b",
    "ball-1": f"{SCENE} --object sphere --out ball-1",
    "ball-bar": f"{SCENE} --object ball-bar --out ball-bar",
    "flat-plate": f"{SCENE} --object flat-plate --out flat-plate",
    "r1": "measure ball-1 --out r1",
    "r2": "measure ball-1 --out r2",
    "r3": "measure ball-bar --out r3",
    "r4": "measure flat-plate --out r4",
    "IMAGES": f"{SCENE} --out IMAGES",
    "demo/result": "demo",
    "my-images": f"{SCENE} --out my-images",
    "BOARD-IMAGES": f"{BOARDS} --object chessboard:9x6:10mm --out BOARD-IMAGES",
    "result": "measure SCAN --out result",
    "RESULT": "measure SCAN --out RESULT",
    "full": "measure SCAN --out full",
    "reduced": "measure SCAN --gray-bits 3 --out reduced",
    "four": "measure SCAN --gray-bits 0 --direction x --out four",
    "OTHER.ply": "measure OTHER --out other-result",
    "other.ply": "measure OTHER --out other-result",
    "design": "design kolibri --out design",
    "accepted": "evaluate acceptance --ball r1 --out accepted",
    "compared": "evaluate compare result OTHER.ply --out compared",
    "patterns/plan.toml": "patterns --size 1024x768 --period 32 --steps 4 --out patterns",
    "rig.toml": "",
    "rig-with-bias.toml": "calibrate bias --from SCAN --out rig-with-bias.toml",
    "cameras.toml": "",
    "moved.toml": "",
    "stereo.yml": "export rig.toml --out stereo.yml",
    "LARGE": "",
    "part.stl": "",
}
"""What makes a thing that commands name; nothing where `made` does it."""

ENDLESS = ("view",)
ENDLESS_S = 60.0
"""So long a view may take to end."""

DESCRIBED = "kept-scan.toml"
"""The description of images that a command is to describe."""

DATA = {"captures": "", "howto-calibrate": "procam-board"}
"""Folders of FRINGE3D_DATA that the pages call FOLDER."""


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
        is_complete = is_whole or len(words) > 2 or (len(words) == 2 and words[0] in ENDLESS)
        if "..." in command or not is_complete:
            continue
        begin = time.perf_counter()
        try:
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
    if words[0] == "report":
        for written in Path(words[1]).glob("report.*"):
            written.unlink()
    for word in words[1:]:
        if word == "FOLDER" and not Path(word).exists():
            data = os.environ.get("FRINGE3D_DATA")
            if data is None or page.stem not in DATA:
                raise MissingError("needs FRINGE3D_DATA")
            Path(word).symlink_to(Path(data) / DATA[page.stem])
        elif word in MAKERS and word not in outs and not Path(word).exists():
            make(word, page, made)


def make(word: str, page: Path, made: Path) -> None:
    """Make a thing; scans are made once for all pages."""
    words = shlex.split(MAKERS[word])
    kept = made / word
    if not kept.exists():
        if words:
            prepare(words, page, made)
            code, said = carried_out(words)
            if code:
                raise MissingError(f"'{' '.join(words)}' failed: {said.strip()[-200:]}")
        else:
            prepare(["", "SCAN"], page, made)
        for source in special(word):
            shutil.copy(source, word)
        if word in ("IMAGES", "my-images"):
            (Path(word) / "scan.toml").rename(Path(word) / DESCRIBED)
        if words[:1] != ["simulate"]:
            return
        made.mkdir(exist_ok=True)
        shutil.move(word, kept)
    shutil.copytree(kept, word)


def special(word: str) -> Iterator[str]:
    """Yield the file that stands for a thing that no command of its own makes."""
    if word in ("rig.toml", "cameras.toml", "moved.toml"):
        yield "SCAN/rig.toml"
    if word.lower() == "other.ply":
        yield "other-result/cloud.ply"
    if word == "part.stl":
        import trimesh

        trimesh.creation.box((30, 20, 10)).export("box.stl")
        yield "box.stl"


def carried_out(words: list[str]) -> tuple[int, str]:
    """Run a command here, endless ones and those that ask apart; return exit code and output."""
    if words[0] == "view" and "--html" not in words:
        return until_it_tells(words)
    if any("gige:" in word or "window:" in word for word in words):
        raise MissingError("needs cameras and a projector")
    if words[0] == "import" and "--camera" not in words:
        described(Path(words[1]))
        raise MissingError("asks the user; tests/test_import.py answers")
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            fringe3d(words)
        except SystemExit as ended:
            return int(ended.code or 0), said.getvalue()
    return 0, said.getvalue()


def described(images: Path) -> None:
    """Leave what the user's answers would have left."""
    shutil.copy(images / DESCRIBED, images / "scan.toml")


def until_it_tells(words: list[str]) -> tuple[int, str]:
    """Run a view until it says its address, and end it."""
    command = [sys.executable, "-m", "fringe3d", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        line = running.stdout.readline()
        running.terminate()  # as Ctrl-C, which does not reach what runs in the background
        return running.wait(ENDLESS_S), line


if __name__ == "__main__":
    sys.exit(main())
