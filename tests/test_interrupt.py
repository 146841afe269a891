"""Ctrl-C at any time: one line, exit code 130, nothing half-written."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import fringe3d.cli

PATIENCE_S = 120.0
"""A slow machine may need minutes until the first file is there."""

SIMULATE = ["simulate", "kolibri", "--camera-size", "160x128", "--out", "o/scan"]


def test_an_interrupted_command_leaves_nothing(tmp_path: Path) -> None:
    """As soon as something is written aside; what it writes stays for half a second and more."""
    pytest.importorskip("embreex")
    folder = tmp_path / "o"
    folder.mkdir()
    command = [sys.executable, "-m", "fringe3d", *SIMULATE]
    listening = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # deaf in the background
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True, preexec_fn=listening) as running:  # fmt: skip
        end = time.monotonic() + PATIENCE_S
        while not list(folder.iterdir()) and time.monotonic() < end:
            time.sleep(0.02)
        running.send_signal(signal.SIGINT)
        out, said = running.communicate(timeout=PATIENCE_S)
    assert (running.returncode, out) == (130, ""), said
    last = said.strip().splitlines()[-1]  # before it may stand that it compiles
    assert last == "error: interrupted; nothing was written"
    assert "Traceback" not in said
    assert list(folder.iterdir()) == []


class Interrupting:
    """Stands for Ctrl-C while the commands are loaded."""

    def find_spec(self, name: str, *_: Any) -> None:
        if name == "fringe3d.cli.run":
            raise KeyboardInterrupt


def test_loading_can_be_interrupted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "fringe3d.cli.run", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupting(), *sys.meta_path])
    with pytest.raises(SystemExit) as ended:
        fringe3d.cli.main(["--version"])
    assert ended.value.code == 130
    assert capsys.readouterr().err == "error: interrupted; nothing was written\n"


def test_the_commands_are_loaded_without_the_libraries_that_measure() -> None:
    """Numba, SciPy's statistics and the drawing of pictures take seconds to load."""
    code = "import fringe3d.cli.run, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"numba", "scipy.stats", "matplotlib", "cv2"} & set(done.stdout.split()) == set()
