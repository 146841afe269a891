"""Progress, messages and exit codes."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text


class Reporter:
    """Progress bars on standard error, results on standard output."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self.console = Console(stderr=True, highlight=False)
        self._progress = Progress(
            TextColumn("{task.description:<26}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}"),
            TimeRemainingColumn(),
            console=self.console,
            transient=True,
            disable=quiet or not self.console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._stages = 0

    @contextmanager
    def running(self) -> Iterator[Reporter]:
        """Show the bars while the block runs; they begin anew with each block."""
        for task in self._tasks.values():
            self._progress.remove_task(task)
        self._tasks, self._stages = {}, 0
        with self._progress:
            yield self

    def step(self, work: str, done: int, total: int) -> None:
        """Tell how far a work is."""
        if work not in self._tasks:
            self._tasks[work] = self._progress.add_task(work, total=total)
        self._progress.update(self._tasks[work], completed=done, total=total)

    def stage(self, name: str, *, of: int = 5) -> None:
        """Tell which stage of a measurement begins."""
        self.step("measuring", self._stages, of)
        self._progress.update(self._tasks["measuring"], description=name)
        self._stages += 1

    def note(self, text: str) -> None:
        """Print a remark, unless only the result is wanted."""
        if not self._quiet:
            self.tell(text)

    def tell(self, text: str) -> None:
        """Print what somebody has to act on, as the address of a page."""
        self.console.print(Text(text), soft_wrap=True)

    def warn(self, text: str) -> None:
        """Print a warning."""
        self.console.print(_labelled("warning:", "yellow", text), soft_wrap=True)


def _labelled(label: str, colour: str, text: str) -> Text:
    """Return a text with a coloured label; nothing in the text is mark-up."""
    return Text.assemble((label, colour), " ", text)


def say(text: str, record: dict[str, Any] | None = None, *, as_json: bool = False) -> None:
    """Print the one-line result, or the record as JSON."""
    told = json.dumps(_without_nan(record), default=str) if as_json else text
    print(told, file=sys.stdout, flush=True)  # noqa: T201


def _without_nan(value: Any) -> Any:
    """Return a record in which what is no number is null: JSON knows neither NaN nor infinity."""
    if isinstance(value, dict):
        return {key: _without_nan(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def fail(text: str) -> None:
    """Print an error."""
    console = Console(stderr=True, highlight=False)
    console.print(_labelled("error:", "red", text), soft_wrap=True)
