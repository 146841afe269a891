"""Phase maps of one camera: wrapped, and with what is known of the fringe order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.model._array import frozen
from fringe3d.model.html import picture, table

NO_ORDER = -(2**31)
"""Stands in integer maps where there is no fringe order (orders may be negative)."""


def some_known(phase: NDArray[np.floating[Any]], n: int, /) -> NDArray[np.intp]:
    """Return the places, in the map made flat, of some n to 2 n pixels that have a phase, of all of
    them where there are fewer.

    An odd step does not stay on the same columns of a fringe.

    Examples
    --------
    >>> some_known(np.array([[0.1, np.nan, 0.3], [0.2, 0.4, 0.5]]), 2)
    array([0, 4])
    """
    flat = phase.ravel()
    step = max(1, flat.size // (8 * n)) | 1  # most maps are known for more than an eighth
    known = step * np.flatnonzero(np.isfinite(flat[::step]))
    if len(known) < n and step > 1:
        known = np.flatnonzero(np.isfinite(flat))
    return np.asarray(known[:: max(1, len(known) // n) | 1], np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Deferred:
    """An array that follows from others; see `deferred`."""

    shape: tuple[int, ...]
    compute: Callable[[], NDArray[Any]]


def deferred(shape: tuple[int, ...], compute: Callable[[], NDArray[Any]], /) -> Any:
    """Stand in for an array that is computed when it is first asked for.

    Parameters
    ----------
    shape : tuple of int
    compute : function without arguments; returns the array, each time the same
    """
    return Deferred(shape, compute)


class _Maps:
    """Maps (row, col) of one shape; those that are `Deferred` are computed at their first use."""

    __slots__ = ("_later",)
    _later: dict[str, Deferred]

    def _freeze(self, **dtypes: Any) -> None:
        object.__setattr__(self, "_later", {})
        shapes = set()
        for name, dtype in dtypes.items():
            value = getattr(self, name)
            if isinstance(value, Deferred):
                self._later[name] = value
                object.__delattr__(self, name)
            else:
                value = frozen(value, dtype)
                object.__setattr__(self, name, value)
            shapes.add(value.shape)
        if len(shapes) != 1 or len(next(iter(shapes))) != 2:
            raise ValueError(f"phase map: expected maps (row, col) of one shape, found {shapes}")

    def __getattr__(self, name: str) -> Any:
        later = None if name == "_later" else self._later.get(name)
        if later is None:  # or another thread has computed it just now
            return object.__getattribute__(self, name)
        array = later.compute()
        array.setflags(write=False)
        object.__setattr__(self, name, array)
        self._later.pop(name, None)  # and with it what it was computed from
        return array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WrappedPhaseMap(_Maps):
    """Wrapped phase of one fringe set.

    Parameters
    ----------
    phase : (row, col) float32, rad, (-pi, pi]; NaN where rejected
    offset, modulation : (row, col) float32, DN; A (above the black level) and B of the fringes
    phase_std : (row, col) float32, rad; predicted standard deviation of `phase`
    rejection : (row, col) uint16; `Rejection` bits
    period_px : float, projector px
    angle : float, rad
    device_name : str
    n_shifts : int
    noise_dn : float, DN; standard deviation of a grey value at the typical brightness
    harmonic_ratio : float; second harmonic over the first, median; NaN with fewer than 5 steps
    """

    phase: NDArray[np.float32]
    offset: NDArray[np.float32]
    modulation: NDArray[np.float32]
    phase_std: NDArray[np.float32]
    rejection: NDArray[np.uint16]
    period_px: float
    angle: float
    device_name: str
    n_shifts: int
    noise_dn: float
    harmonic_ratio: float

    def __post_init__(self) -> None:
        f4 = np.float32
        self._freeze(phase=f4, offset=f4, modulation=f4, phase_std=f4, rejection=np.uint16)

    def _repr_html_(self) -> str:
        rows = [*_figures(self), ("steps", self.n_shifts), ("noise", f"{self.noise_dn:.3g} DN")]
        title = f"wrapped phase of camera '{self.device_name}'"
        return table(title, rows, more=picture(self.phase))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhaseMap(_Maps):
    """Phase of one direction and what the code tells of its fringe order.

    The code may single out the fringe order, or only a *class* of orders that it cannot tell
    apart (reduced code: every 2**n-th order). ``class_of_order[i]`` is the class of order
    ``first_order + i``, named after its smallest member; a class of one member is the order
    itself. `first_order` is negative where the fringe angle makes w negative.

    Parameters
    ----------
    phase : (row, col) float32, rad, [0, 2 pi); wrapped phase; NaN where rejected
    order_class : (row, col) int32; `NO_ORDER` where rejected
    class_of_order : (n_orders,) int32
    first_order : int
    phase_std : (row, col) float32, rad
    offset, modulation : (row, col) float32, DN
    rejection : (row, col) uint16; `Rejection` bits
    period_px : float, projector px
    angle : float, rad
    device_name : str
    n_mended : int; pixels whose code the phase or the neighbours corrected by one cell
    is_quantised : bool; known to whole code cells only (Gray code without fringes)
    detailed_std : (row, col) float32, rad, or None; `phase_std` and what is uncertain of the phase
        besides noise: detail that a pixel averages. For the points alone: orders are weighed by
        noise
    alike : float, 0 to 1; correlation of the errors of neighbouring pixels, where interpolation
        between them was foreseen when `phase_std` was computed (filtered phases)
    """

    phase: NDArray[np.float32]
    order_class: NDArray[np.int32]
    class_of_order: NDArray[np.int32]
    phase_std: NDArray[np.float32]
    offset: NDArray[np.float32]
    modulation: NDArray[np.float32]
    rejection: NDArray[np.uint16]
    period_px: float
    angle: float
    device_name: str
    first_order: int = 0
    n_mended: int = 0
    is_quantised: bool = False
    detailed_std: NDArray[np.float32] | None = None
    alike: float = 0.0

    def __post_init__(self) -> None:
        f4 = np.float32
        self._freeze(
            phase=f4,
            order_class=np.int32,
            phase_std=f4,
            offset=f4,
            modulation=f4,
            rejection=np.uint16,
        )
        object.__setattr__(self, "class_of_order", frozen(self.class_of_order, np.int32))
        if self.detailed_std is not None:
            object.__setattr__(self, "detailed_std", frozen(self.detailed_std, np.float32))

    def rejecting(self, rejection: NDArray[np.uint16]) -> PhaseMap:
        """Return the map with these `Rejection` bits added, (row, col)."""
        bad = rejection != 0
        return replace(
            self,
            phase=np.where(bad, np.nan, self.phase),
            order_class=np.where(bad, NO_ORDER, self.order_class),
            rejection=self.rejection | rejection,
        )

    def every(self, step: int, /) -> PhaseMap:
        """Return the map of every step-th row and column."""
        part = slice(None, None, step), slice(None, None, step)
        return replace(
            self,
            phase=self.phase[part],
            order_class=self.order_class[part],
            phase_std=self.phase_std[part],
            offset=self.offset[part],
            modulation=self.modulation[part],
            rejection=self.rejection[part],
            detailed_std=None if self.detailed_std is None else self.detailed_std[part],
        )

    @property
    def point_std(self) -> NDArray[np.float32]:
        """Return (row, col) rad; the standard deviation of the phase for the points."""
        return self.phase_std if self.detailed_std is None else self.detailed_std

    def without_orders(self) -> PhaseMap:
        """Return the map with all orders in one class: the wrapped phase alone."""
        return replace(
            self,
            order_class=np.where(self.rejection == 0, np.int32(self.first_order), NO_ORDER),
            class_of_order=np.full_like(self.class_of_order, self.first_order),
        )

    @property
    def is_absolute(self) -> bool:
        """Tell whether the code singles out the fringe order."""
        orders = np.arange(len(self.class_of_order)) + self.first_order
        return bool((self.class_of_order == orders).all())

    @property
    def absolute_phase(self) -> NDArray[np.float64]:
        """Return (row, col) rad, ``phase + 2 pi order``; NaN where rejected.

        Raises
        ------
        ValueError
            If the code leaves several orders.
        """
        if not self.is_absolute:
            raise ValueError("phase map: the code is reduced; the absolute phase is not known")
        return self.phase + 2 * np.pi * self.order_class.astype(np.float64)

    @property
    def position_px(self) -> NDArray[np.float64]:
        """Return (row, col), projector px: the coordinate w across the fringes."""
        return self.absolute_phase * (self.period_px / (2 * np.pi))

    def _repr_html_(self) -> str:
        n_orders, n_classes = len(self.class_of_order), len(np.unique(self.class_of_order))
        known = "each known" if self.is_absolute else f"told apart in {n_classes} classes"
        rows = [*_figures(self), ("fringe orders", f"{n_orders}, {known}")]
        shown = self.position_px if self.is_absolute else self.phase
        title = f"phase of camera '{self.device_name}'"
        return table(title, rows, more=picture(shown))


def _figures(maps: WrappedPhaseMap | PhaseMap) -> list[tuple[str, object]]:
    """Return what both kinds of maps say of themselves."""
    good, total = int((maps.rejection == 0).sum()), maps.rejection.size
    figures: list[tuple[str, object]] = [
        ("fringes", f"period {maps.period_px:g} px, {np.degrees(maps.angle):g} deg"),
        ("pixels", f"{good:,} of {total:,} ({good / max(total, 1):.1%})"),
    ]
    if good:
        sigma = float(np.median(maps.phase_std[maps.rejection == 0]))
        figures.append(("sigma of the phase", f"median {sigma:.4f} rad"))
    return figures
