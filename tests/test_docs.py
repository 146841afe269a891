"""What README and docs print can be typed, and what they link to is there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import MissingArgumentError

from fringe3d.cli.app import app

ROOT = Path(__file__).parent.parent
PAGES = sorted(
    path
    for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    if "_build" not in path.parts
)


def blocks(text: str) -> Iterator[str]:
    """Yield the lines of fenced blocks, continued lines joined."""
    for block in re.findall(r"^ *```[^\n]*\n(.*?)^ *```", text, flags=re.S | re.M):
        yield from block.replace("\\\n", " ").splitlines()


def commands(path: Path) -> Iterator[tuple[str, bool]]:
    """Yield the commands of a page, and whether they stand whole in a block."""
    text = path.read_text(encoding="utf-8")
    for line in blocks(text):
        found = re.match(r"\s*\$? *(?:\.venv/bin/)?(fringe3d [a-z].*)", line)
        if found and "->" not in found[1]:
            yield found[1], True
    for span in re.findall(r"(?<!`)`(?:\.venv/bin/)?(fringe3d [a-z][^`\n]*)`", text):
        yield span, False


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_commands_are_understood(path: Path) -> None:
    """They are read as typed, not carried out: every option exists and takes what is given."""
    for command, is_whole in commands(path):
        if "..." in command:
            continue
        tokens = shlex.split(command, comments=True)[1:]
        try:
            app.parse_args(tokens, exit_on_error=False, print_error=False)
        except MissingArgumentError:
            assert not is_whole, command
        except Exception as problem:
            raise AssertionError(f"{command}: {problem}") from problem


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_links_lead_somewhere(path: Path) -> None:
    text = re.sub(r"^ *```.*?^ *```", "", path.read_text(encoding="utf-8"), flags=re.S | re.M)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not re.match(r"[a-z]+:", target):
            assert (path.parent / target).exists(), target
