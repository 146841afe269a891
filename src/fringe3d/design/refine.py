"""The refinement behind `optimise`: from good places of a survey to the best of each kind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, minimize

from fringe3d.design.margin import NEEDED_RATIO
from fringe3d.design.search import Landscape
from fringe3d.design.task import BETWEEN, TOLERANCE, Figures, Limits, Task
from fringe3d.errors import RigError
from fringe3d.model import Rig

Array = NDArray[np.float64]
Kind = Literal["turned", "moved", "moved and turned", "several periods", "one period"]

CHEAPEST: tuple[Kind, ...] = ("several periods", "one period")
"""Kinds that are to have the least price; the others the largest ratio."""

STEPS = 60
APART = 1.6
"""Spacings between places that are refined."""

NEARLY, DEARER = 0.3, 3.0
"""Periods by which places that are refined may miss one period, and their price for each."""

NOTHING_LIT = Figures(ratio=-50.0, price=9.0, reach=9.0, rooms=-np.ones(3))
"""Where the devices do not meet in the volume: bad, yet finite, for optimisers subtract."""

PENALTY = 200.0
"""Ratio lost for each unit by which a limit is exceeded (rad, parts, periods)."""

SEVERAL_PERIODS = 2.0
"""Periods from which on a rig is said to have several."""

SPARE_PRICE = 0.99
"""Part of the highest price: that of the few points of the search differs by a hundredth."""

ROOM = 1.02
"""Ratio over what is needed: a fine grid of pixels gives 1 % less than the coarse one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place of the projector and an angle of the fringes, rad; `is_moved` if not the given."""

    tilt: float
    azimuth: float
    angle: float
    is_moved: bool

    @staticmethod
    def of(trial: Array, *, is_moved: bool) -> Place:
        """Return the place of a trial: the tilts along two axes, and the fringe angle."""
        tilt, azimuth = np.hypot(trial[0], trial[1]), np.arctan2(trial[1], trial[0])
        return Place(
            tilt=float(tilt), azimuth=float(azimuth), angle=float(trial[2]), is_moved=is_moved
        )

    @property
    def trial(self) -> Array:
        """Return the tilts along two axes, and the fringe angle, (3,)."""
        level = self.tilt * np.array([np.cos(self.azimuth), np.sin(self.azimuth)])
        return np.array([*level, self.angle])

    def rig(self, task: Task) -> Rig:
        """Return the task's rig with its projector there."""
        if not self.is_moved:
            return task.rig
        return task.stand.placed(task.rig, min(self.tilt, math.radians(80.0)), self.azimuth)


def refine(
    task: Task, kind: Kind, landscape: Landscape, /, *, near: Sequence[Place] = ()
) -> list[Place]:
    """Improve the best places of a kind in the landscape, within the limits.

    Parameters
    ----------
    task : Task
    kind : "turned" (the projector stays), "moved" (the fringes stay), "moved and turned",
        "several periods" or "one period" (both, with segments of at least two or below one period)
    landscape : Landscape
    near : sequence of Place; to start from, too, where they have the kind's periods; only for the
        last two kinds

    Returns
    -------
    list of Place; the best first, on the few pixels of the search; empty if there is none

    Notes
    -----
    The exact margins lead, not the first order of the landscape. The first three kinds are to have
    the largest ratio (Nelder-Mead; what exceeds a limit costs `PENALTY`), the other two the least
    price at which it is enough (linear approximations of ratio and limits, COBYLA). Residuals of
    several periods are too ragged for these until a place is known where the ratio is enough.
    """
    climb = _Climb(task=task, kind=kind, slope_deg=task.slopes_deg[-1])
    starts = _starts(climb.value(landscape), landscape, task.limits)
    if kind in CHEAPEST:
        starts += [place.trial for place in near if climb.has_periods(place.trial)]
    found = [climb.cheaper(start) for start in starts] if kind == "one period" else []
    if not any(climb.is_enough(trial) for trial in found):
        found += [climb.higher(start) for start in starts]
        if kind in CHEAPEST:
            found += [climb.cheaper(trial) for trial in found if climb.is_enough(trial)]
    return climb.sorted(found)


def cheapen(
    task: Task, kind: Kind, landscape: Landscape, places: Sequence[Place], slope_deg: float, /
) -> list[Place]:
    """Look for the least price at which the ratio is enough on surfaces up to a flatter slope.

    Parameters
    ----------
    task : Task
    kind : "several periods" or "one period"
    landscape : Landscape; its best places are tried once more
    places : sequence of Place; where the ratio is enough on such surfaces
    slope_deg : float, deg

    Returns
    -------
    list of Place; as `refine`
    """
    climb = _Climb(task=task, kind=kind, slope_deg=slope_deg)
    starts = [place.trial for place in places]
    starts += _starts(climb.value(landscape), landscape, task.limits)
    return climb.sorted([climb.cheaper(start) for start in starts])


def _starts(value: Array, landscape: Landscape, limits: Limits) -> list[Array]:
    """Return the best places of a landscape that lie apart: tilts along two axes, fringe angle."""
    tilts, azimuths = landscape.tilts, landscape.azimuths
    spots = np.stack([tilts * np.cos(azimuths), tilts * np.sin(azimuths)], axis=-1)
    value = value.copy()
    starts: list[Array] = []
    while len(starts) < limits.n_starts and np.isfinite(value).any():
        at, turned = np.unravel_index(np.nanargmax(value), value.shape)
        starts.append(np.array([*spots[at], landscape.angles[turned]]))
        near = np.linalg.norm(spots - spots[at], axis=-1) < APART * limits.spacing
        value[near] = np.nan
    return starts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Climb:
    """The search for the best of a kind; trials are tilts along two axes and the fringe angle."""

    task: Task
    kind: Kind
    slope_deg: float

    @property
    def is_moved(self) -> bool:
        return self.kind != "turned"

    @property
    def free(self) -> list[int]:
        return {"turned": [2], "moved": [0, 1]}.get(self.kind, [0, 1, 2])

    def value(self, land: Landscape) -> Array:
        """Return what each place and angle (n, m) is worth; NaN where it is not of the kind."""
        price, lacking = land.sigma_mm / self.task.sigma_mm, -self._reach_room(land.reach)
        if self.kind == "one period":  # its ratio is known only once no wrong order is left
            value = -price - DEARER * np.maximum(0.0, lacking)
            value[lacking > NEARLY] = np.nan
        else:
            value = -self._aim(land.ratio, price)
            value[lacking > 0] = np.nan
        value[land.sigma_mm > land.max_sigma_mm] = np.nan
        if not self.is_moved:
            value[1:] = np.nan
        else:
            value[~land.allowed] = np.nan
        if self.kind == "moved":
            value[:, 1:] = np.nan
        return value

    def higher(self, start: Array) -> Array:
        """Return where Nelder-Mead ends: the least loss."""
        first = self.task.limits.spacing / 2 * np.eye(len(self.free))

        def loss(step: Array) -> float:
            return self.loss(self._stepped(start, step))

        best = minimize(
            loss, np.zeros(len(self.free)), method="Nelder-Mead",
            options={
                "initial_simplex": np.vstack([np.zeros(len(self.free)), first]), "maxfev": STEPS,
                "xatol": 1e-3, "fatol": 0.005,
            },
        )  # fmt: skip
        return self._stepped(start, best.x)

    def cheaper(self, start: Array) -> Array:
        """Return where COBYLA ends: the least price within limits and ratio."""
        known: dict[bytes, Figures] = {}  # price and limits are asked for one after the other

        def figures(step: Array) -> Figures:
            key = np.asarray(step, np.float64).tobytes()
            if key not in known:
                known[key] = self._figures(self._stepped(start, step))
            return known[key]

        def price(step: Array) -> float:
            return figures(step).price

        def rooms(step: Array) -> Array:
            found = figures(step)
            return np.append(self._rooms(found), found.ratio / (ROOM * NEEDED_RATIO) - 1)

        best = minimize(
            price, np.zeros(len(self.free)), method="COBYLA",
            constraints=NonlinearConstraint(rooms, 0.0, np.inf),
            options={"rhobeg": self.task.limits.spacing / 2, "maxiter": STEPS, "tol": 1e-4},
        )  # fmt: skip
        return self._stepped(start, best.x)

    def loss(self, trial: Array) -> float:
        """Return what is to be as small as possible."""
        found = self._figures(trial)
        # Limits are kept to within a tolerance: less is no excess.
        excess = np.maximum(0.0, -self._rooms(found) - TOLERANCE / 2).sum()
        return float(PENALTY * excess + self._aim(np.array(found.ratio), np.array(found.price)))

    def sorted(self, trials: Sequence[Array]) -> list[Place]:
        """Return the places of trials, the least loss first."""
        return [Place.of(trial, is_moved=self.is_moved) for trial in sorted(trials, key=self.loss)]

    def has_periods(self, trial: Array) -> bool:
        """Tell whether a trial has the periods that the kind asks for."""
        return bool(self._reach_room(np.array(self._figures(trial).reach)) >= 0)

    def is_enough(self, trial: Array) -> bool:
        """Tell whether a trial has the ratio that is needed, within the limits."""
        found = self._figures(trial)
        return found.ratio >= NEEDED_RATIO and bool((self._rooms(found) >= -TOLERANCE).all())

    def _stepped(self, start: Array, step: Array) -> Array:
        trial = start.copy()
        trial[self.free] += step
        return trial

    def _figures(self, trial: Array) -> Figures:
        """Judge a trial; where the projector stands, it can stand."""
        place = Place.of(trial, is_moved=self.is_moved)
        try:
            found = self.task.judged(
                place.rig(self.task), place.angle, self.slope_deg,
                with_orders=self.kind != "one period",
            )  # fmt: skip
        except RigError:
            return NOTHING_LIT
        return found if self.is_moved else replace(found, rooms=np.ones(3))

    def _rooms(self, found: Figures) -> Array:
        """Return the room (n,) to all limits; negative beyond them."""
        reach = float(self._reach_room(np.array(found.reach)))
        price = SPARE_PRICE * self.task.limits.max_price - found.price
        return np.array([*found.rooms, price, reach])

    def _reach_room(self, reach: Array) -> Array:
        """Return by how many periods segments have what the kind asks for; negative: miss it."""
        if self.kind == "one period":
            return 1 - BETWEEN - 2 * self.task.guard - reach
        return reach - SEVERAL_PERIODS if self.kind == "several periods" else np.ones_like(reach)

    def _aim(self, ratio: Array, price: Array) -> Array:
        """Return -ratio, or the price once the ratio is enough."""
        if self.kind in CHEAPEST:
            return np.asarray(price + np.maximum(0.0, ROOM * NEEDED_RATIO - ratio))
        return -ratio
