"""A right hand that lies on its palm, fingers slightly spread and bent."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects._implicit import (
    Values,
    capsule,
    common,
    ellipsoid,
    mesh_of,
    union,
    within,
)

Point = tuple[float, float, float]

LIFE_SIZE_MM = 211.0
"""mm; from the cut through the wrist to the tip of the middle finger of an adult."""

MIDDLE_MM = (-6.0, 83.0, 2.5)
"""mm; x and y of the middle, z of the table, into which the soft parts are pressed; y = 0 is the
crease of the wrist."""

WRIST_CUT_MM = -20.0

WRINKLE_MM = 0.3

LOWEST_VEIN_MM = 24.0

BLEND_REACH_MM = 14.0
"""mm; how far from a digit it may still bend the surface of its neighbours."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Digit:
    """A finger: life-size joints from the knuckle to the tip, radii there, where its nail looks."""

    joints: tuple[Point, Point, Point, Point]
    radii: tuple[float, float, float, float]
    back: Point = (0.0, 0.0, 1.0)
    wrinkled: tuple[int, ...] = (1, 2)


THUMB = Digit(
    joints=((-19, 16, 20), (-43, 52, 21), (-57, 80, 18), (-62, 103, 10)),
    radii=(13.0, 11.0, 10.2, 8.4),
    back=(-0.5, -0.1, 0.85),
    wrinkled=(2,),
)
FINGERS = (
    Digit(joints=((-23, 88, 28), (-31, 129, 27), (-35, 153, 18), (-36.5, 171, 7.2)),
          radii=(10.6, 9.4, 8.3, 7.0), back=(-0.12, 0, 1)),
    Digit(joints=((-2, 92, 30), (-3, 138, 29), (-3, 165, 19), (-3, 184, 7.3)),
          radii=(10.8, 9.6, 8.4, 7.1)),
    Digit(joints=((18, 86, 28), (25, 128, 27), (29, 154, 18), (31, 173, 7)),
          radii=(10.2, 9.0, 7.9, 6.8), back=(0.08, 0, 1)),
    Digit(joints=((36, 75, 24), (49, 107, 23), (55, 125, 15), (59, 141, 6.2)),
          radii=(9.2, 7.9, 7.0, 6.0), back=(0.2, 0, 1)),
)  # fmt: skip
CARPALS: tuple[Point, ...] = ((-12, 10, 25), (-3, 8, 26), (6, 8, 25), (13, 10, 22))
VEINS = (
    ((-16, -6), (-13, 12), (-14, 30), (-6, 44), (-8, 58), (-11, 72), (-10, 84)),
    ((-6, 44), (6, 56), (8, 68), (7, 80)),
    ((13, -4), (12, 14), (19, 34), (23, 52), (27, 64), (27, 76)),
    ((19, 34), (10, 44), (6, 56)),
)
"""Lines (x, y) on the back of the hand."""


def hand(*, length_mm: float = 72.0, resolution_mm: float = 0.22) -> Mesh:
    """Return a model of a right hand, back upwards, the fingers towards +y.

    Parameters
    ----------
    length_mm : from the wrist to the tip of the middle finger, mm
    resolution_mm : size of the triangles, mm

    Returns
    -------
    Mesh
        Closed, bottom at z = 0; 72 mm long it fits a cylinder 76 mm wide and 24 mm high.

    Raises
    ------
    ValueError
        If the resolution is not positive or too coarse for the fingers.

    Examples
    --------
    >>> vertices = hand(resolution_mm=1.5).vertices_mm
    >>> [round(float(v)) for v in vertices.max(axis=0) - vertices.min(axis=0)]
    [46, 72, 14]
    """
    if not 0 < resolution_mm <= length_mm / 40:
        raise ValueError(
            f"hand: expected 0 < resolution_mm <= length_mm / 40 = {length_mm / 40:g} mm,"
            f" found {resolution_mm:g} mm"
        )
    scale = length_mm / LIFE_SIZE_MM
    half = 0.55 * length_mm
    solid = partial(_scaled_hand, scale=scale)
    return mesh_of(solid, (-half, -half, 0), (half, half, 0.3 * length_mm), resolution_mm)


def _scaled_hand(points: Values, *, scale: float) -> Values:
    return scale * _life_size(points / scale + np.array([MIDDLE_MM]).T)


def _life_size(points: Values) -> Values:
    """Return the field of the hand, mm, the crease of the wrist at y = 0."""
    body = within(_palm, points, (-70, -60, -20), (65, 115, 65))
    body = union(body, _near(THUMB, points), 9.0)
    fingers = _near(FINGERS[0], points)
    for finger in FINGERS[1:]:
        fingers = union(fingers, _near(finger, points), 3.0)
    body = union(body, fingers, 6.0)
    return common(body, WRIST_CUT_MM - points[1], 2.0)


def _near(digit: Digit, points: Values) -> Values:
    """Return the field of a digit, evaluated only where it matters."""
    joints, reach = np.array(digit.joints), max(digit.radii) + BLEND_REACH_MM
    solid = partial(_digit, digit=digit)
    return within(solid, points, joints.min(axis=0) - reach, joints.max(axis=0) + reach)


def _palm(points: Values) -> Values:
    """Return metacarpals, balls of thumb and little finger, wrist, tendons and veins."""
    body = capsule(points * np.array([[1.0], [1.0], [1.45]]), (-2, -40, 28), (0, 16, 33), 26, 25)
    for start, finger in zip(CARPALS, FINGERS, strict=True):
        bone = capsule(points, start, finger.joints[0], 13.5, finger.radii[0] + 0.5)
        body = union(body, bone, 9.0)
    pads = (
        ((-20, 38, 14), (17, 30, 14)),
        ((25, 36, 13), (17, 34, 14)),
        ((4, 74, 16), (34, 14, 13)),
    )
    for center, radii in pads:
        body = union(body, ellipsoid(points, center, radii), 10.0)
    web = capsule(points, (-36, 50, 19), (-22, 66, 22), 7.0, 8.0)
    body = union(body, web, 16.0)
    body = union(body, ellipsoid(points, (16, -6, 33), (7, 9, 7)), 7.0)
    for start, finger in zip(CARPALS, FINGERS, strict=True):
        x, y, z = finger.joints[0]
        knuckle = ellipsoid(points, (x, y - 1, z + finger.radii[0] - 5), (7, 8, 8))
        body = union(body, knuckle, 5.0)
        tendon_start = (0.7 * start[0], start[1] + 14, start[2] + 11.5)
        tendon = capsule(points, tendon_start, (x, y - 6, z + finger.radii[0] - 1.5), 2.4, 2.6)
        body = union(body, tendon, 6.0)
    return body - 0.7 * _veins(points)


def _veins(points: Values) -> Values:
    """Return soft lines on the back of the hand, 0 to 1."""
    lines = np.zeros(points.shape[1])
    back = points[2] > LOWEST_VEIN_MM
    lines[back] = _lines(points[:, back])
    return lines


def _lines(points: Values) -> Values:
    flat = points * np.array([[1.0], [1.0], [0.0]])
    line = np.full(points.shape[1], np.inf)
    for vein in VEINS:
        for start, end in pairwise(vein):
            line = union(line, capsule(flat, (*start, 0), (*end, 0), 0.0, 0.0), 3.0)
    above = 1 / (1 + np.exp(-(points[2] - LOWEST_VEIN_MM - 9) / 2))
    return np.asarray(above * np.exp(-((np.maximum(line, 0.0) / 2.2) ** 2)))


def _digit(points: Values, *, digit: Digit) -> Values:
    """Return three phalanges with thickened joints, wrinkles and a nail."""
    joints, radii = np.array(digit.joints, np.float64), digit.radii
    body = np.full(points.shape[1], np.inf)
    for i in range(3):
        waist = 0.5 * (joints[i] + joints[i + 1])
        thin = 0.482 * (radii[i] + radii[i + 1])
        body = np.minimum(body, capsule(points, joints[i], waist, radii[i], thin))
        near = capsule(points, waist, joints[i + 1], thin, radii[i + 1])
        body = union(body, near, 3.0)
    body = union(body, _pad(points, joints, radii), 3.0)
    across, along, up = _frame(joints[2], joints[3], digit.back)
    body = body + _nail(points, joints[3], (across, along, up), radii[3])
    for joint in digit.wrinkled:
        axes = _frame(joints[joint - 1], joints[joint + 1], digit.back)
        body = body + WRINKLE_MM * _wrinkles(points, joints[joint], axes, radii[joint])
    return body


def _pad(points: Values, joints: Values, radii: tuple[float, ...]) -> Values:
    """Return the soft pad below the tip."""
    middle = 0.45 * joints[2] + 0.55 * joints[3] - np.array([0, 0, 1.0])
    return capsule(points, middle, joints[3], radii[3], 0.96 * radii[3])


def _frame(start: Values, end: Values, back: Point) -> tuple[Values, Values, Values]:
    """Return the directions across, along and out of the back of a phalanx."""
    along = (end - start) / np.linalg.norm(end - start)
    across = np.cross(along, back)
    across /= np.linalg.norm(across)
    return across, along, np.cross(across, along)


def _local(points: Values, origin: Values, axes: tuple[Values, Values, Values]) -> Values:
    return np.asarray(np.stack(axes) @ (points - origin[:, None]))


def _nail(
    points: Values, tip: Values, axes: tuple[Values, Values, Values], radius: float
) -> Values:
    """Return a displacement: a fold around a slightly raised plate; positive is inwards."""
    across, along, up = _local(points, tip, axes)
    half_width, length = 0.72 * radius, 1.5 * radius
    corner = 0.55 * radius
    x = np.abs(across) - half_width + corner
    y = np.abs(along + 0.15 * radius) - length / 2 + corner
    outside = np.hypot(np.maximum(x, 0), np.maximum(y, 0)) + np.minimum(np.maximum(x, y), 0)
    border = outside - corner
    on_back = 1 / (1 + np.exp(-(up - 0.25 * radius)))
    fold = 0.75 * np.exp(-((border / 0.8) ** 2))
    plate = 0.35 / (1 + np.exp(border / 0.4))
    return np.asarray(on_back * (fold - plate))


def _wrinkles(
    points: Values, joint: Values, axes: tuple[Values, Values, Values], radius: float
) -> Values:
    """Return folds of the skin across the back of a joint, between -1 and 1."""
    across, along, up = _local(points, joint, axes)
    where = np.exp(-((along / (0.5 * radius)) ** 2) - (across / (0.75 * radius)) ** 4)
    bent = along - 0.03 * across**2 * np.tanh(along)
    return np.asarray(where * (up > 0) * np.cos(2 * np.pi * bent / 3.4))
