"""A mistyped command line gets the nearest spelling, whatever else is wrong with it."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from fringe3d.cli import main

LINES = {
    "mesure x": 'Unknown command "mesure". Did you mean "measure"?',
    "calibrate tabel": 'Unknown command "calibrate tabel". Did you mean "calibrate table"?',
    "calibrate tabel --ball r0 --out t": 'Did you mean "calibrate table"?',
    "evaluate aceptance --ball r1": 'Did you mean "evaluate acceptance"?',
    "--versoin": "Unknown option: --versoin. Did you mean --version?",
    "measure scan --metod m2": "Unknown option: --metod. Did you mean --method?",
    "measure scan --out r --metod m2": "Unknown option: --metod. Did you mean --method?",
    "measure --no-light-drak": "Did you mean --no-light-dark?",
    "measure --no-light-dark": "measure: expected SCAN, found none. See fringe3d measure --help",
    "measure scan --out": "measure: expected a value after --out, found none.",
    "evaluate acceptance --bal r1": "Unknown option: --bal. Did you mean --ball?",
    "calibrate table --ball r1": "calibrate table: expected --diameter, found none.",
    "measure scan --out r --filter mediun": 'Did you mean "medium"?',
}


@pytest.mark.parametrize("line", LINES)
def test_the_nearest_spelling_is_named(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(line))
    said = capsys.readouterr()
    assert ended.value.code == 2
    assert said.out == ""
    assert LINES[line] in said.err
    assert "Traceback" not in said.err


def test_a_folder_named_like_a_command_is_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`calibrate FOLDER` and `calibrate COMMAND` share a place: what exists is the folder."""
    monkeypatch.chdir(tmp_path)

    Path("tables").mkdir()
    with pytest.raises(SystemExit):
        main(["calibrate", "tables"])
    assert "expected --out, found none" in capsys.readouterr().err
