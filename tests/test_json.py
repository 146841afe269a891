"""Every command prints its result as JSON, and then nothing else on standard output."""

from __future__ import annotations

import inspect
import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cyclopts import App

from board_series import C1, C2
from closed_form import Recording
from fringe3d.cli import main
from fringe3d.cli.app import app
from fringe3d.cli.console import say
from fringe3d.io.rigfile import rig_text
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import Rig
from stored_result import write_stored_result

ENDLESS = 60.0
"""A view that has not said where it is by then hangs."""


def commands(of: App, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name in of:
        if not name.startswith("-"):
            part = of[name]
            if part.default_command is not None:
                yield " ".join([*path, name]), part.default_command
            yield from commands(part, (*path, name))


@pytest.mark.parametrize(
    ("name", "function"), [pytest.param(*pair, id=pair[0]) for pair in commands(app)]
)
def test_every_command_has_the_option(name: str, function: Any) -> None:
    assert "as_json" in inspect.signature(function).parameters, name


def printed(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any]:
    main([*map(str, words), "--json"])
    record = json.loads(capsys.readouterr().out)
    assert isinstance(record, dict)
    return record


def test_patterns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "patterns"
    found = printed(capsys, "patterns", "--size", "96x64", "--period", "16", "--out", out)
    # Four steps; 12 half periods need 4 bits.
    assert found["n_images"] == 8 == len(list(out.glob("*[0-9].png")))
    assert found["size"] == [96, 64]
    assert found["out"] == str(out)


def test_export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, out = tmp_path / "rig.toml", tmp_path / "stereo.yml"
    rig.write_text(rig_text(Rig(cameras=(C1, C2))), encoding="utf-8")
    found = printed(capsys, "export", rig, "--out", out, "--inverse-pose")
    assert found == {"out": str(out), "devices": ["c1", "c2"], "maps_from": "c2", "maps_to": "c1"}


def test_simulate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "scan"
    found = printed(capsys, "simulate", "kolibri", "--object", "plane", "--plan", "m5",
                    "--camera-size", "64x48", "--rays", "1", "--out", out)  # fmt: skip
    assert found["n_images"] == 4 == len(list((out / "c1").glob("*.png")))
    assert (found["n_scans"], found["cameras"]) == (1, ["c1", "c2"])


def test_import(recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = tmp_path / "images"
    write_scan(images, recording[0])
    (images / "scan.toml").unlink()
    found = printed(
        capsys, "import", images, "--camera", "c1=c1/{index:03d}.png",
        "--camera", "c2=c2/{index:03d}.png", "--sequence", "fringes period_px=16 n_shifts=4",
        "--sequence", "gray cell_px=8 n_bits=7", "--projector-size", "1024x768",
        "--rig", images / "rig.toml",
    )  # fmt: skip
    assert found["points"] > 0
    assert found["rig"] == str(images / "rig.toml")
    assert {"level", "name", "value", "text"} <= found["health"][0].keys()


def test_view_as_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, page = write_stored_result(tmp_path / "result"), tmp_path / "page.html"
    assert printed(capsys, "view", result, "--html", page)["bytes"] == page.stat().st_size


def test_view_tells_its_address_and_answers_there(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    result = write_stored_result(tmp_path / "result")
    words = [sys.executable, "-m", "fringe3d", "view", str(result), "--port", "8123", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as running:
        try:
            assert running.stdout is not None
            found = json.loads(running.stdout.readline())
            host, port = found["address"].removeprefix("http://").split(":")
            socket.create_connection((host, int(port)), timeout=ENDLESS).close()
            assert found["results"] == [str(result)]
        finally:
            running.terminate()
    assert running.returncode == 0


def test_what_is_no_number_is_null(capsys: pytest.CaptureFixture[str]) -> None:
    """RFC 8259: "Infinity and NaN are not permitted"."""

    def refused(constant: str) -> Any:
        raise AssertionError(constant)

    say("", {"a": float("nan"), "b": [1.5, {"c": float("-inf")}]}, as_json=True)
    told = json.loads(capsys.readouterr().out, parse_constant=refused)
    assert told == {"a": None, "b": [1.5, {"c": None}]}
