"""The command line's root, and what its commands share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

from cyclopts import App, Parameter

from fringe3d import __version__
from fringe3d.errors import MethodError

app = App(
    name="fringe3d",
    version=__version__,
    help="Fringe-projection 3D measurement with few images. Lengths in mm, pixels from 0.",
    suppress_keyboard_interrupt=False,  # main() says that nothing was written
)

app.register_install_completion_command(
    help="Let the shell complete commands, options and paths (bash, zsh, fish)."
)

Json = Annotated[bool, Parameter(name="--json", negative=(), help="Print the result as JSON.")]
Overwrite = Annotated[bool, Parameter(negative=(), help="Replace what is there.")]


def at_least(low: float, high: float = math.inf, /) -> Callable[[type, Any], None]:
    """Return a check that a number, or each of several, is finite and not below `low`."""

    def check(_type: type, value: Any) -> None:
        for number in value if isinstance(value, list) else [value]:
            if number is not None and not (low <= number <= high and number < math.inf):
                upto = "" if high == math.inf else f" and at most {high:g}"
                raise ValueError(f"Expected a number of at least {low:g}{upto}.")

    return check


SIMULATOR_PACKAGES = ("embreex", "manifold3d", "skimage", "trimesh")


@contextmanager
def simulator_installed(command: str, /) -> Iterator[None]:
    """Say what to install if the block finds a package of the simulator missing."""
    try:
        yield
    except ModuleNotFoundError as problem:
        missing = (problem.name or "").partition(".")[0]
        if missing not in SIMULATOR_PACKAGES:
            raise
        raise MethodError(
            f"{command}: expected the packages of the simulator, found no '{missing}'. Install "
            "them: pip install 'fringe3d[simulate]'"
        ) from None


@contextmanager
def view_installed(command: str, otherwise: str, /) -> Iterator[None]:
    """Say what to install if the block finds a package of the 3D view missing, or what to do
    without."""
    try:
        yield
    except ModuleNotFoundError as problem:
        raise MethodError(
            f"{command}: expected the packages of the 3D view, found no '{problem.name}'. Install "
            f"them: pip install 'fringe3d[view]'{otherwise}"
        ) from None
