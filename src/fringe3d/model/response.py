"""How grey values follow the projected patterns: the response, and the ripple it leaves."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

EQUAL_RAD = 1e-3
"""Steps that differ by less from equal ones are equal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ripple:
    """What a nonlinear response does to the phase of N equal steps, and its cure.

    The true phase is ``phase + sum_k sines[k - 1] sin(k N (phase - origin))``.

    Parameters
    ----------
    period_px : float, projector px
    angle : float, rad; of the fringes
    n_shifts : int; number N of steps
    origin : float, rad; the shift of any step
    sines : tuple of float, rad
    """

    period_px: float
    angle: float
    n_shifts: int
    origin: float
    sines: tuple[float, ...]

    def correction(self, phase: ArrayLike, /) -> NDArray[np.float64]:
        """Return what is to be added to measured phases, rad, of their shape.

        Examples
        --------
        >>> ripple = Ripple(period_px=16, angle=0, n_shifts=3, origin=0, sines=(0.2,))
        >>> ripple.correction([0, np.pi / 6]).round(3).tolist()
        [0.0, 0.2]
        """
        wave = self.n_shifts * (np.asarray(phase, np.float64) - self.origin)
        total = np.zeros_like(wave)
        for k, sine in enumerate(self.sines, 1):
            total += sine * np.sin(k * wave)
        return total

    def slope(self, phase: ArrayLike, /) -> NDArray[np.float64]:
        """Return the derivative of the true phase with respect to the measured one."""
        wave = self.n_shifts * (np.asarray(phase, np.float64) - self.origin)
        total = np.ones_like(wave)
        for k, sine in enumerate(self.sines, 1):
            total += k * self.n_shifts * sine * np.cos(k * wave)
        return total

    @property
    def amplitude(self) -> float:
        """Return the rms error of an uncorrected phase, rad."""
        return float(np.sqrt(sum(s * s for s in self.sines) / 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """How the grey values of one camera follow the patterns.

    Parameters
    ----------
    device_name : str; of the camera
    levels, values : tuple of float, 0 to 1; relative brightness `values` at the pattern `levels`,
        both rising from 0 to 1; empty where only the ripples are known
    ripples : tuple of Ripple, as measured: blur of projector and camera is in them
    gamma : float; of the power that is nearest; NaN where not known
    source : str; what it was found from
    """

    device_name: str
    levels: tuple[float, ...] = ()
    values: tuple[float, ...] = ()
    ripples: tuple[Ripple, ...] = ()
    gamma: float = float("nan")
    source: str = ""

    def __post_init__(self) -> None:
        for name in ("levels", "values"):
            known = getattr(self, name)
            rises = all(a <= b for a, b in pairwise(known))
            if known and not (rises and known[0] == 0 and known[-1] == 1):
                raise ValueError(f"response: {name}: expected numbers that rise from 0 to 1")
        if len(self.levels) != len(self.values):
            raise ValueError(
                f"response: expected as many values as levels, found {len(self.values)} and "
                f"{len(self.levels)}"
            )

    @property
    def has_curve(self) -> bool:
        """Tell whether more than ripples is known."""
        return len(self.levels) > 1


def equal_steps(shifts: tuple[float, ...], /) -> bool:
    """Tell whether steps divide the period evenly, whatever their order.

    Examples
    --------
    >>> equal_steps((0.0, -np.pi / 2, np.pi, np.pi / 2)), equal_steps((0.0, 1.0, 2.0))
    (True, False)
    """
    places = np.sort(np.mod(np.asarray(shifts) - shifts[0] + EQUAL_RAD, 2 * np.pi))
    even = 2 * np.pi / len(shifts) * np.arange(len(shifts)) + EQUAL_RAD
    return len(shifts) > 2 and bool(np.abs(places - even).max() < EQUAL_RAD)
