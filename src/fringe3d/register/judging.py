"""Which view does not fit the others: a scan whose calibration, or whose body, had moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fringe3d.model import Registration

ODD = 1.5
"""A view's own part of the residuals over that of the others, from which on it is named."""

FAR, FAR_MM = 6.0, 0.02
"""Times as far beside the turn of the table as the others, and mm at least."""

LEAST_VIEWS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class OddView:
    """A view that does not fit the others.

    Parameters
    ----------
    view : int
    rms_mm : float, mm; its own part of the residuals in its overlaps; NaN where it has none
    typical_mm : float, mm; that of the others
    off_mm, off_typical_mm : float, mm; how far it lies beside the table's turn, and the others;
        NaN without a table
    why : str; in words
    """

    view: int
    rms_mm: float
    typical_mm: float
    off_mm: float
    off_typical_mm: float
    why: str


def own_parts(found: Registration, /) -> NDArray[np.float64]:
    """Return each view's own part of the residuals, (n,) mm.

    The mean square of a pair's residuals is taken as the sum of a part of each of the two views; so
    one bad view does not make all bad that it overlaps with.
    """
    n = len(found.body_from_view)
    rows = np.zeros((len(found.after), n))
    squares = np.array([pair.rms_mm**2 for pair in found.after])
    weights = np.sqrt([min(pair.n_points, 1000) for pair in found.after])
    for k, pair in enumerate(found.after):
        rows[k, [pair.first, pair.second]] = 1
    # Relative errors of mean squares are alike: large ones must not drown the others.
    weights = weights / np.maximum(squares, 1e-12) ** 0.5
    return np.sqrt(nnls(rows * weights[:, None], squares * weights)[0])


def odd_views(found: Registration, /) -> tuple[OddView, ...]:
    """Return the views whose own part of the residuals stands out.

    Parameters
    ----------
    found : Registration; of four views at least, else there is nothing to compare with
    """
    if len(found.body_from_view) < LEAST_VIEWS or not found.after:
        return ()
    parts = own_parts(found)
    n = len(parts)
    paired = {k for pair in found.after for k in (pair.first, pair.second)}
    off = np.full(n, np.nan) if found.table is None else found.table.off_mm
    odd = []
    for k in range(n):
        typical, usual = (_median(np.delete(values, k)) for values in (parts, off))
        why = _why(k in paired, parts[k], typical, off[k], usual)
        if why:
            odd.append(OddView(view=k, rms_mm=float(parts[k]) if k in paired else np.nan,
                               typical_mm=typical, off_mm=float(off[k]), off_typical_mm=usual,
                               why=why))  # fmt: skip
    return tuple(odd)


def _why(is_paired: bool, part: float, typical: float, off: float, usual: float) -> str:
    """Say what is odd of a view; nothing if nothing is."""
    if not is_paired:
        return "it lies on no other view"
    if part > ODD * typical:
        return (
            f"its surface differs by {1000 * part:.0f} um from that of the other views, theirs by "
            f"{1000 * typical:.0f} um"
        )
    if off > max(FAR * usual, FAR_MM):
        return (
            f"it lies {1000 * off:.0f} um beside the turn of the table, the others "
            f"{1000 * usual:.1f} um"
        )
    return ""


def _median(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
