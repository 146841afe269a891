"""The examples run as they stand, each below 60 lines, and print what they promise."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
FILES = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
MOST_LINES = 60

PRINTED = {
    "00": "points by method m2",
    "01": "Gray code that tells them apart: 0 cyclic images",
    "02": "reduced code: 7 images",
    "03": "points of 81,920 pixels by method m1",
    "04": "ok: no pose sticks out",
    "05": "fringes alone, all pixels",
    "06": "<- taken",
    "07": "exchanged-images: camera 'c1': images 1 ",
    "08": "scans a second",
    "09": "sphere spacing",
}
"""A line of each that tells whether it did what it is for."""


def test_there_are_ten() -> None:
    assert [path.name[:2] for path in FILES] == sorted(PRINTED)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_example_runs(
    path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < MOST_LINES
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    said = capsys.readouterr()
    assert PRINTED[path.name[:2]] in said.out
    assert ": fail" not in said.out  # a limit that is broken
