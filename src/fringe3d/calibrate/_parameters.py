"""The numbers of a fit as a user knows them, with their standard deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.calibrate._camera import INDEX, N_NUMBERS, focal_of, rotation_of
from fringe3d.calibrate._problem import Problem, axes_of, is_oblique
from fringe3d.calibrate._solve import Solution

Floats = NDArray[np.float64]

HELD_PART = 0.5
"""A number whose spread the data did not halve is held by what was likely beforehand."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number of the projector and how certain it is.

    Parameters
    ----------
    name : str; with its unit
    value, sigma : float; sigma is the standard deviation; 0 for a convention
    held_by : "data", "prior" (the data did not halve what was likely beforehand) or "convention"
        (the fringes cannot show it)
    """

    name: str
    value: float
    sigma: float
    held_by: Literal["data", "prior", "convention"]


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """A number, how it follows from the 15, and its spread before the fit."""

    name: str
    value: float
    slope: Floats
    spread: float = float("inf")
    is_shown: bool = True


def parameters_of(
    problem: Problem, at: Solution, covariance: Floats, lens: str, /
) -> tuple[Parameter, ...]:
    """Return the numbers of a projector.

    Seen through oblique fringes of one direction alone, the axes are across and along them.
    """
    angle = float(problem.rows.angle[0])
    names, axes, shown = ("x", "y"), np.eye(2), (True, True)
    if problem.n_directions == 1:
        oblique = is_oblique(angle)
        names, axes = (("across", "along"), axes_of(angle)) if oblique else (names, axes)
        is_first = oblique or abs(np.cos(angle)) > abs(np.sin(angle))
        shown = (is_first, not is_first)
    lines = [*_focal(problem, at, shown)]
    for axis, name, is_shown in zip(axes, names, shown, strict=True):
        spread = float(np.hypot(*(axis * problem.likely.spread[8:10])))
        value = float(axis @ at.numbers[8:10])
        lines.append(_Line(f"center_{name}_px", value, _slope(8, axis), spread, is_shown))
    lines += _pose(problem, at, (*names, "z"), axes, (*shown, True))
    for name in lens.split() if lens != "pinhole" else ():
        place = INDEX[name]
        spread = float(problem.likely.spread[place])
        lines.append(_Line(name, float(at.numbers[place]), _slope(place, 1.0), spread))
    return tuple(_parameter(line, covariance) for line in lines)


def _slope(place: int, value: Floats | float) -> Floats:
    """Return a row of derivatives that is zero but for these."""
    row = np.zeros(N_NUMBERS)
    row[place : place + np.size(value)] = value
    return row


def _focal(problem: Problem, at: Solution, shown: tuple[bool, bool]) -> Iterator[_Line]:
    focal = focal_of(at.numbers)
    spread = problem.likely.spread
    if problem.n_directions == 1:
        value = float(focal[0] if shown[0] else focal[1])
        yield _Line("focal_px", value, _slope(6, value), value * float(spread[6]))
        return
    for i, name in enumerate("xy"):
        value = float(focal[i])
        both = value * float(np.linalg.norm(spread[6 : 7 + i]))
        yield _Line(f"focal_{name}_px", value, _slope(6, np.full(1 + i, value)), both)


def _pose(
    problem: Problem,
    at: Solution,
    names: tuple[str, ...],
    axes: Floats,
    shown: tuple[bool, ...],
) -> Iterator[_Line]:
    rotation = rotation_of(at.numbers, at.start)
    vector = np.degrees(Rotation.from_matrix(rotation).as_rotvec())
    for i, name in enumerate("xyz"):
        yield _Line(f"rotation_{name}_deg", float(vector[i]), _slope(i, float(np.degrees(1.0))))
    # The translation is the middle in the device frame less the turned middle of the world.
    x, y, z = lever = rotation @ problem.middle_mm
    moved = np.zeros((3, N_NUMBERS))
    moved[:, :3], moved[:, 3:6] = [[0, -z, y], [z, 0, -x], [-y, x, 0]], np.eye(3)
    upright = np.eye(3)
    upright[:2, :2] = axes
    for axis, name, is_shown in zip(upright, names, shown, strict=True):
        value = float(axis @ (at.numbers[3:6] - lever))
        yield _Line(f"translation_{name}_mm", value, axis @ moved, is_shown=is_shown)


def _parameter(line: _Line, covariance: Floats) -> Parameter:
    if not line.is_shown:
        return Parameter(line.name, line.value, 0.0, "convention")
    sigma = float(np.sqrt(max(float(line.slope @ covariance @ line.slope), 0.0)))
    held_by: Literal["data", "prior"] = "data" if sigma < HELD_PART * line.spread else "prior"
    return Parameter(line.name, line.value, sigma, held_by)
