"""A lower dental arch: fourteen teeth, gums and a horseshoe base, as on a plaster cast."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects._arch import GUM_MM, Arch, Curve
from fringe3d.simulate.objects._crowns import HALF_ARCH, Crown, crown_field
from fringe3d.simulate.objects._implicit import Values, in_chunks, mesh_of, rotation, union, within

WIDTH_MM = 66.0
"""mm; outer width of the base, life-size."""

LIFTS_MM = (0.1, 0.1, -0.1, 0.1, 0.1, 0.2, 0.9)
"""mm; gum line of each tooth above `GUM_MM`, from the middle: the curve of Spee."""

LEANS_DEG = (2.0, 2.0, 0.0, -3.0, -5.0, -9.0, -12.0)
"""deg; how far each crown leans to the lips or the cheek, from the middle."""

CLOSER_MM = (0.12, 0.42, 0.44, 0.32, 0.03, -0.01, 0.01)
"""mm; by how much each tooth may stand nearer to the one before it than widths alone allow:
outlines are round, and crowns stand outside the curve on which their necks stand."""

ALBEDO_TOOTH, ALBEDO_GUM = 0.8, 0.55
ALBEDO_EDGE_MM = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Tooth:
    """A crown with its place; the rows of `axes` are u, v and w, left-handed on the left."""

    crown: Crown
    origin_mm: Values
    axes: Values

    def field(self, points: Values) -> Values:
        """Return the field of the crown at points (3, n)."""
        return crown_field(self.axes @ (points - self.origin_mm[:, None]), self.crown)

    def near(self, points: Values) -> Values:
        """Return the field, evaluated only where it matters."""
        reach = np.array([17.0, 17.0, 14.0])
        top = np.array([0.0, 0.0, 8.0])
        return within(self.field, points, self.origin_mm - reach, self.origin_mm + reach + top)


@dataclass(frozen=True, slots=True, eq=False)
class Cast:
    """All parts of the model."""

    curve: Curve
    arch: Arch
    teeth: tuple[Tooth, ...]

    def gums(self, points: Values) -> Values:
        """Return the field of gums and base."""
        return self.arch.gums(points, *self.curve.coordinates(points))

    def crowns(self, points: Values) -> Values:
        """Return the field of all crowns."""
        fields = (tooth.near(points) for tooth in self.teeth)
        nearest = next(fields)
        for field in fields:
            nearest = np.minimum(nearest, field)
        return nearest

    def __call__(self, points: Values) -> Values:
        """Return the field of the cast."""
        return union(self.gums(points), self.crowns(points), 0.45)


def teeth(
    *,
    width_mm: float = WIDTH_MM,
    gap_mm: float = 0.5,
    irregularity: float = 1.0,
    seed: int = 1,
    resolution_mm: float = 0.22,
) -> Mesh:
    """Return a lower dental arch, incisors towards -y, chewing surfaces up.

    Parameters
    ----------
    width_mm : of the base, mm; 66 mm is life-size and 24 mm high
    gap_mm : between neighbouring teeth, mm, life-size
    irregularity : spread of the positions; 0 is symmetric, 1 natural, 2 crooked
    seed : of the positions
    resolution_mm : size of the triangles, mm

    Returns
    -------
    Mesh
        Closed, bottom at z = 0; teeth brighter than gums.

    Raises
    ------
    ValueError
        If a size is out of range.

    Examples
    --------
    >>> vertices = teeth(resolution_mm=1.0).vertices_mm
    >>> [round(float(v)) for v in vertices.max(axis=0) - vertices.min(axis=0)]
    [66, 54, 24]
    """
    _check(width_mm, gap_mm, irregularity, resolution_mm)
    cast = _cast(gap_mm, irregularity * np.random.default_rng(seed).uniform(-1, 1, (14, 5)))
    scale = width_mm / WIDTH_MM

    def solid(points: Values) -> Values:
        return scale * cast(points / scale)

    box = scale * np.array([[-37.0, -39.0, 0.0], [37.0, 26.0, 25.0]])
    mesh = mesh_of(solid, box[0], box[1], resolution_mm)
    points = mesh.vertices_mm.T / scale
    clear_of_gums = in_chunks(cast.gums, points) - in_chunks(cast.crowns, points)
    share = np.clip(clear_of_gums / ALBEDO_EDGE_MM, 0.0, 1.0)
    albedo = ALBEDO_GUM + (ALBEDO_TOOTH - ALBEDO_GUM) * share
    return replace(mesh, albedo=albedo.astype(np.float32))


def _check(width_mm: float, gap_mm: float, irregularity: float, resolution_mm: float) -> None:
    """Raise ValueError for sizes that give no teeth."""
    ranges = (
        ("width_mm", width_mm, 10.0, 200.0),
        ("gap_mm", gap_mm, 0.0, 1.0),
        ("irregularity", irregularity, 0.0, 2.0),
        ("resolution_mm", resolution_mm, width_mm / 1000, width_mm / 50),
    )
    for name, value, low, high in ranges:
        if not low <= value <= high:
            raise ValueError(f"teeth: expected {low:g} <= {name} <= {high:g}, found {value:g}")


def _cast(gap_mm: float, shifts: Values) -> Cast:
    """Place the teeth along the arch; each row of the shifts moves and turns one."""
    curve = Curve()
    widths = np.array([crown.width_mm + gap_mm for crown in HALF_ARCH])
    widths[0] -= CLOSER_MM[0]
    half = np.cumsum(widths) - widths / 2 - np.cumsum([0.0, *CLOSER_MM[1:]])
    placed = []
    for side, rows in ((-1, shifts[:7]), (1, shifts[7:])):
        for number, crown in enumerate(HALF_ARCH):
            placed.append(_placed(curve, number, crown, side, side * half[number], rows[number]))
    depths = np.array([crown.depth_mm for crown in HALF_ARCH])
    arch = Arch(
        arcs_mm=np.concatenate([-half[::-1], half]),
        depths_mm=np.concatenate([depths[::-1], depths]),
        lifts_mm=np.array([*LIFTS_MM[::-1], *LIFTS_MM]),
        end_mm=float(half[-1] + widths[-1] / 2 + 1.5),
    )
    return Cast(curve, arch, tuple(placed))


def _placed(
    curve: Curve, number: int, crown: Crown, side: int, arc_mm: float, shift: Values
) -> Tooth:
    """Return a tooth on the curve, moved a little."""
    point, (tx, ty) = curve.at(arc_mm)
    outwards = np.array([ty, -tx])
    sideways, upwards, turn, lean, tip = shift * [0.3, 0.12, 2.5, 2.0, 1.0]
    origin = np.array([*(point + sideways * outwards), GUM_MM + LIFTS_MM[number] + upwards])
    upright = np.array([[side * tx, side * ty, 0], [*outwards, 0], [0, 0, 1.0]])
    turned = rotation(2, turn) @ rotation(0, LEANS_DEG[number] + lean) @ rotation(1, tip)
    return Tooth(crown, origin, turned @ upright)
