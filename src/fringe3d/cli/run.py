"""Run a command; mistakes become one message and an exit code."""

from __future__ import annotations

import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

from cyclopts import CycloptsError

from fringe3d.cli.app import app
from fringe3d.cli.console import fail
from fringe3d.cli.mistakes import told
from fringe3d.errors import AccuracyWarning, Fringe3DError


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; exit code 0 done, 2 for a mistake that the user can mend."""
    warnings.simplefilter("default", AccuracyWarning)
    with suppress(ValueError):  # only the main thread may: a killed run tidies up, too
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as problem:
        fail(told(problem))
        sys.exit(2)
    except Fringe3DError as problem:
        fail(str(problem))
        sys.exit(2)
    except OSError as problem:
        fail(f"{problem}. Check the path, its permissions and the space on the disk")
        sys.exit(2)
    except MemoryError:
        fail("expected images that fit into memory, found none free. Take smaller or fewer ones")
        sys.exit(2)
    except KeyboardInterrupt as stop:
        stop_interrupted(getattr(stop, "__notes__", ["nothing was written"]))


def stop_interrupted(kept: Sequence[str]) -> NoReturn:
    """Say what is left of the work; exit code 130."""
    fail(f"interrupted; {'; '.join(kept)}")
    # Where text was being executed, as in a dataclass's module, CPython remembers the interrupt and
    # ends by the signal whatever follows; executing text again makes it forget.
    exec("")
    sys.exit(130)
