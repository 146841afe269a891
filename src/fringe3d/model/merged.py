"""One cloud of many views, and what became of every point."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fringe3d.model._array import frozen, require_shape
from fringe3d.model.html import table


class Fate(IntEnum):
    """What became of a point of a view."""

    NONE = 0
    KEPT = 1
    AVERAGED = 2
    NO_NORMAL = 3
    OTHER_LAYER = 4
    SEEN_THROUGH = 5
    EDGE = 6


FATES = {
    Fate.KEPT: "kept: it stands for its place, averaged with what other views saw there",
    Fate.AVERAGED: "averaged into the point of a view that saw the place less flatly",
    Fate.NO_NORMAL: "dropped: too few neighbours to tell how the surface lies",
    Fate.OTHER_LAYER: "dropped: more weighty views saw the surface a little beside",
    Fate.SEEN_THROUGH: "dropped: other views looked through it, and none confirmed it",
    Fate.EDGE: "dropped: beside an edge of what its view saw; another point stands for the place, "
    "it is too uncertain, or its neighbours do not confirm it",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MergedCloud:
    """Points of all views as one surface.

    Parameters
    ----------
    points_mm : (n, 3) float64, mm; body frame
    normals : (n, 3) float32; unit length, outwards
    sigma_mm : (n,) float32, mm; standard deviation along the normal, after averaging
    grey : (n,) uint8
    n_views : (n,) uint8; views that were averaged
    source : (n,) uint16; number of the view that the point comes from
    fates : tuple of (row, col) uint8; `Fate` of each pixel of each view
    """

    points_mm: NDArray[np.float64]
    normals: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    grey: NDArray[np.uint8]
    n_views: NDArray[np.uint8]
    source: NDArray[np.uint16]
    fates: tuple[NDArray[np.uint8], ...]

    def __post_init__(self) -> None:
        n = len(self.points_mm)
        for name, dtype, shape in (
            ("points_mm", np.float64, (n, 3)),
            ("normals", np.float32, (n, 3)),
            ("sigma_mm", np.float32, (n,)),
            ("grey", np.uint8, (n,)),
            ("n_views", np.uint8, (n,)),
            ("source", np.uint16, (n,)),
        ):
            array = frozen(getattr(self, name), dtype)
            require_shape(f"merged cloud: {name}", array, shape)
            object.__setattr__(self, name, array)
        if self.counts().get(Fate.KEPT, 0) != n:
            raise ValueError("merged cloud: every point must be accounted for once")

    def counts(self) -> dict[Fate, int]:
        """Return how many points of all views had each fate."""
        total = np.zeros(len(Fate), np.int64)
        for fate in self.fates:
            total += np.bincount(fate.ravel(), minlength=len(Fate))
        return {f: int(total[f]) for f in Fate if f is not Fate.NONE and total[f]}

    def _repr_html_(self) -> str:
        rows: list[tuple[str, object]] = [("points", f"{len(self.points_mm):,}")]
        rows += [(FATES[fate], f"{count:,}") for fate, count in self.counts().items()]
        return table("merged cloud", rows)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfaceMesh:
    """A mesh of triangles with what is known of its vertices.

    Parameters
    ----------
    vertices_mm : (n, 3) float64, mm
    faces : (m, 3) int32; anticlockwise seen from outside
    normals : (n, 3) float32
    sigma_mm : (n,) float32, mm; of the points around a vertex; NaN where there are none: a hole
        that was closed
    grey : (n,) uint8
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    grey: NDArray[np.uint8]

    @property
    def is_closed(self) -> bool:
        """Tell whether each edge belongs to two faces that go along it in opposite directions."""
        a = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        keys = a[:, 0].astype(np.int64) * (len(self.vertices_mm) + 1) + a[:, 1]
        back = a[:, 1].astype(np.int64) * (len(self.vertices_mm) + 1) + a[:, 0]
        unique = np.unique(keys)
        return len(unique) == len(keys) and np.array_equal(unique, np.unique(back))
