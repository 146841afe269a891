"""The head of the bust, right half: x >= 0, y up from the chin, z forward from the ear canal.

The proportions are those of drawing schools, the head 40 mm high: eyes at half of it, the base
of the nose halfway between brow and chin, five eyes to the width.
"""

from __future__ import annotations

import numpy as np

from fringe3d.simulate.objects._implicit import (
    Values,
    bump,
    capsule,
    carved,
    common,
    ellipsoid,
    union,
)

EYE = (5.6, 20.0, 11.6)
"""mm; centre of an eyeball."""

EYEBALL_MM = 2.5
LID_MM = 0.5


def face(half: Values) -> Values:
    """Return the field of the head, mm."""
    body = _skull(half)
    body = _with_eye_socket(half, body)
    body = _with_nose(half, body)
    body = _with_mouth(half, body)
    body = union(body, _eye(half), 0.8)
    body = union(body, _hair(half), 0.5)
    return union(body, _ear(half), 2.0)


def _skull(half: Values) -> Values:
    """Return cranium, forehead, cheeks and jaw."""
    body = ellipsoid(half, (0, 26.3, 0.3), (13.2, 13.6, 15.6))
    body = union(body, ellipsoid(half, (0, 17, 3.5), (10.6, 13, 12.2)), 4.0)
    jaw = capsule(half, (8.0, 7.8, 2.5), (1.3, 3.2, 12.6), 3.2, 2.4)
    body = union(body, jaw, 6.0)
    body = union(body, ellipsoid(half, (0, 2.8, 13.6), (2.9, 2.5, 2.5)), 4.0)
    body = union(body, ellipsoid(half, (0, 9.4, 12.2), (5.8, 4.8, 4.5)), 4.0)
    body = union(body, ellipsoid(half, (6.2, 10.8, 8.3), (3.8, 5.0, 4.6)), 4.0)
    body = union(body, ellipsoid(half, (7.7, 15.6, 9.8), (3.2, 2.8, 3.4)), 4.0)
    body = union(body, ellipsoid(half, (7.6, 24.0, 6.5), (4.2, 5.5, 5.0)), 4.0)
    body = union(body, ellipsoid(half, (0, 22.8, 14.3), (2.6, 2.2, 1.8)), 3.0)
    brow = capsule(half, (2.4, 22.6, 14.9), (5.8, 23.5, 14.0), 1.1, 1.1)
    tail = capsule(half, (5.8, 23.5, 14.0), (9.2, 22.4, 10.6), 1.1, 0.9)
    return union(body, union(brow, tail, 1.0), 3.2)


def _with_eye_socket(half: Values, body: Values) -> Values:
    body = carved(body, ellipsoid(half, (5.5, 19.9, 15.6), (3.4, 2.2, 3.2)), 2.2)
    return carved(body, ellipsoid(half, (2.7, 20.2, 16.4), (1.1, 1.7, 2.2)), 1.6)


def _eye(half: Values) -> Values:
    """Return eyeball and lids; the gap between the lids is an almond."""
    x, y, z = half[0] - EYE[0], half[1] - EYE[1], half[2] - EYE[2]
    distance = np.sqrt(x**2 + y**2 + z**2)
    ball = distance - EYEBALL_MM
    tilt = y - 0.08 * x
    arc = np.clip(1 - ((x + 0.1) / 2.6) ** 2, -4.0, 1.0)
    opening = common(tilt - 1.02 * arc, -0.85 * arc - tilt, 0.3)
    lids = carved(distance - EYEBALL_MM - LID_MM, np.maximum(opening, -z), 0.35)
    iris = np.hypot(x + 0.05, tilt - 0.1)
    ball = ball + 0.3 * np.exp(-((iris / 0.6) ** 4)) * (z > 0)
    return union(ball, lids, 0.3)


def _with_nose(half: Values, body: Values) -> Values:
    bridge = capsule(half, (0, 21.4, 14.3), (0, 14.2, 18.5), 1.0, 1.3)
    body = union(body, bridge, 1.8)
    body = union(body, ellipsoid(half, (0, 13.7, 18.7), (1.6, 1.4, 1.6)), 1.0)
    body = union(body, ellipsoid(half, (1.9, 13.1, 16.9), (1.1, 1.25, 1.9)), 1.3)
    body = carved(body, ellipsoid(half, (1.15, 11.9, 17.4), (0.6, 0.75, 1.0)), 0.5)
    return union(body, capsule(half, (0, 13.0, 18.4), (0, 11.8, 16.4), 0.55, 0.6), 0.6)


def _with_mouth(half: Values, body: Values) -> Values:
    """Add lips, the line between them, philtrum and the folds beside the mouth."""
    x = half[0]
    curved = half.copy()
    curved[2] = half[2] + 0.055 * x**2
    upper = capsule(curved, (1.0, 9.6, 16.5), (3.9, 8.65, 16.3), 1.1, 0.4)
    upper = union(upper, ellipsoid(curved, (0, 9.1, 16.7), (0.9, 0.7, 0.75)), 0.6)
    lower = capsule(curved, (0.0, 7.3, 16.5), (3.7, 8.25, 16.2), 1.35, 0.4)
    body = union(body, upper, 0.7)
    body = union(body, lower, 0.8)
    line = half[1] - (8.5 + 0.12 * np.cos(1.7 * x) * np.exp(-x / 2))
    ends = 1 / (1 + np.exp((x - 4.2) / 0.15))
    front = half[2] > 8
    body = body + 0.5 * np.exp(-((line / 0.42) ** 2)) * ends * front
    body = body + 0.35 * bump(half, (4.4, 8.4, 15), (0.6, 0.7, 3))
    body = body + 0.35 * bump(half, (0, 10.7, 16.8), (0.45, 0.9, 2))
    body = body - 0.18 * bump(half, (1.0, 10.6, 16.8), (0.4, 0.9, 2))
    return body + 0.3 * bump(half, (0, 5.7, 15.8), (2.2, 0.8, 2))


def _ear(half: Values) -> Values:
    """Return the shell of an ear, its rim and the hollow in front of it."""
    leaning = half.copy()
    leaning[0] = half[0] - 0.45 * (-half[2]) - 12.4
    leaning[2] = half[2] + 0.12 * (half[1] - 17)
    shell = ellipsoid(leaning, (0, 17.6, -2.2), (1.3, 4.7, 2.9))
    lobe = ellipsoid(leaning, (-0.2, 13.6, -1.0), (1.1, 1.7, 1.5))
    shell = union(shell, lobe, 1.0)
    hollow = ellipsoid(leaning, (1.5, 17.6, -1.5), (1.2, 3.3, 1.8))
    shell = carved(shell, hollow, 0.5)
    return union(shell, ellipsoid(leaning, (0.2, 16.6, 0.3), (0.8, 1.0, 0.7)), 0.6)


def _hair(half: Values) -> Values:
    """Return a cap of combed hair down to the hairline."""
    x, y, z = half
    cap = ellipsoid(half, (0, 26.9, -0.6), (14.5, 14.8, 16.6))
    hairline = 33.0 - 0.02 * x**2 - 1.6 * np.maximum(x - 8.0, 0)
    away = np.minimum(0.7 * (hairline - y), np.maximum(0.6 * (z - 5.0), 19.0 - y))
    # Combed straight back: strands are circles around the axis through the ears.
    parting = np.arctan2(x, np.hypot(y - 20, z + 2))
    wave = parting + 0.03 * np.sin(0.5 * y - 0.4 * z)
    strands = 0.22 * np.cos(38 * wave) + 0.1 * np.cos(89 * wave + 0.2 * z)
    return common(cap - strands, away, 1.0)
