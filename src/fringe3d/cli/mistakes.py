"""What is wrong with a command line, in one sentence: where, expected, found, what to do."""

from __future__ import annotations

import difflib
from pathlib import Path

from cyclopts import App, CycloptsError, MissingArgumentError, UnknownCommandError
from cyclopts.exceptions import UnusedCliTokensError

LIKE = 0.6
"""So much (0 to 1) a word must be like a command or an option to be taken for one mistyped."""


def told(problem: CycloptsError, /) -> str:
    """Return what is wrong with a command line, and what to do.

    Parameters
    ----------
    problem : CycloptsError
        What the command line's parser says.

    Examples
    --------
    >>> from fringe3d.cli.app import app
    >>> try:
    ...     app(["calibrate", "tabel"], exit_on_error=False, print_error=False)
    ... except CycloptsError as problem:
    ...     print(told(problem))
    Unknown command "calibrate tabel". Did you mean "calibrate table"? See fringe3d calibrate --help
    """
    chain = list(problem.command_chain or [])
    typed = list(problem.root_input_tokens or [])[len(chain) :]
    text = (
        _mistyped_command(problem.app, chain, typed)
        or _mistyped_option(problem, typed)
        or _missing(problem, chain)
        or _too_many(problem, chain)
        or " ".join(str(problem).split())
    )
    return f"{text} See {' '.join(['fringe3d', *chain])} --help"


def _mistyped_command(app: App | None, chain: list[str], typed: list[str]) -> str | None:
    """Return what to say where the first word is meant to be a command of a command."""
    if app is None or not chain or not typed or typed[0].startswith("-") or Path(typed[0]).exists():
        return None
    names = [name for name in app if not name.startswith("-")]
    close = difflib.get_close_matches(typed[0], names, n=1, cutoff=LIKE)
    if not close:
        return None
    before = " ".join(chain)
    return f'Unknown command "{before} {typed[0]}". Did you mean "{before} {close[0]}"?'


def _mistyped_option(problem: CycloptsError, typed: list[str]) -> str | None:
    """Return what to say of an option that the command does not have."""
    if problem.app is None or not isinstance(problem, UnknownCommandError | MissingArgumentError):
        return None
    known = [*problem.app.help_flags, *problem.app.version_flags]
    if isinstance(problem, MissingArgumentError):
        known += [
            n for argument in problem.app.assemble_argument_collection() for n in argument.names
        ]
    else:
        known += [name for name in problem.app if name.startswith("-")]
    for word in typed:
        option = word.partition("=")[0]
        if not option.startswith("--") or option == "--" or option in known:
            continue
        close = difflib.get_close_matches(option, known, n=1, cutoff=LIKE)
        hint = f" Did you mean {close[0]}?" if close else ""
        return f"Unknown option: {option}.{hint}"
    return None


def _missing(problem: CycloptsError, chain: list[str]) -> str | None:
    """Return what to say where something is missing that the command needs."""
    if not isinstance(problem, MissingArgumentError) or problem.argument is None:
        return None
    name = problem.argument.name
    if name in (problem.unused_tokens or []):
        return f"{' '.join(chain)}: expected a value after {name}, found none."
    return f"{' '.join(chain)}: expected {name}, found none."


def _too_many(problem: CycloptsError, chain: list[str]) -> str | None:
    """Return what to say of words that nobody asked for."""
    if not isinstance(problem, UnusedCliTokensError):
        return None
    words = " ".join(problem.unused_tokens or [])
    return f"{' '.join(chain)}: expected nothing more, found {words}."
