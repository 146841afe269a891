"""How many distortion terms the views of a board hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fringe3d.calibrate._board_information import Information
from fringe3d.calibrate._bundle import (
    N_DEVICE,
    State,
)
from fringe3d.model.covariance import DEVICE_NUMBERS

BoardLens = Literal[
    "pinhole", "k1", "k1 p1 p2", "k1 k2 p1 p2", "k1 k2 p1 p2 k3", "rational", "known"
]

BOARD_LENSES: tuple[BoardLens, ...] = (
    "pinhole", "k1", "k1 p1 p2", "k1 k2 p1 p2", "k1 k2 p1 p2 k3", "rational",
)  # fmt: skip
"""From simple to complex; each holds those before it. Rational: k1 to k6, p1 and p2."""

LADDER = BOARD_LENSES[3:5]
"""Those that are tried. A simpler lens would save nothing: where it seems enough, the numbers that
it leaves out bend the others by many of their sigma. The rational one is for wide angles and must
be asked for."""

CONFIDENCE = 0.99
"""With which k3 must differ from zero to be kept."""


@dataclass(frozen=True, slots=True)
class BoardLensTrial:
    """How much a simpler lens would lack.

    Parameters
    ----------
    lens : str; its terms
    lacking : float; chi^2 of the terms that it has not
    limit : float; that they would have by noise, but for one time in a hundred
    """

    lens: BoardLens
    lacking: float
    limit: float


def free_of(lens: BoardLens, /) -> NDArray[np.bool_]:
    """Return which numbers of a device's lens are free, (18,)."""
    if lens == "known":
        return np.zeros(N_DEVICE, bool)
    terms = "k1 k2 p1 p2 k3 k4 k5 k6" if lens == "rational" else lens
    wanted = {"fx", "fy", "cx", "cy", *terms.split()}
    return np.array([name in wanted for name in DEVICE_NUMBERS])


def choose_board_lens(
    device: str, number: int, at: State, info: Information, /
) -> tuple[tuple[BoardLensTrial, ...], BoardLens]:
    """Choose the simplest lens whose missing terms could as well be zero.

    Parameters
    ----------
    device, number : name and place of the device
    at : State; fitted with the last lens of the ladder
    info : Information; of that fit
    """
    trials = []
    for lens in LADDER:
        terms = [t for t in LADDER[-1].split() if t not in lens.split()]
        places = [info.names.index(f"{device}.{term}") for term in terms]
        values = np.array([at.lens[number, DEVICE_NUMBERS.index(term)] for term in terms])
        part = info.covariance[np.ix_(places, places)]
        lacking = float(values @ np.linalg.solve(part, values)) if terms else 0.0
        limit = float(chi2.ppf(CONFIDENCE, len(terms))) if terms else 0.0
        trials.append(BoardLensTrial(lens, lacking, limit))
    chosen = next(t.lens for t in trials if t.lacking <= t.limit)
    return tuple(trials), chosen
