"""Words of ``fringe3d simulate``: knocks, axes, tilts."""

from __future__ import annotations

import math
import re

from fringe3d.errors import MethodError


def parse_knock(text: str, /) -> tuple[str, float, float]:
    """Return device, turn in degrees and shift in mm of ``--knock``.

    Examples
    --------
    >>> parse_knock("c2:0.05deg:0.1mm")
    ('c2', 0.05, 0.1)
    """
    form = re.fullmatch(r"([^:]+):([\d.]+)deg:([\d.]+)mm", text)
    try:
        if form is None:
            raise ValueError
        return form[1], float(form[2]), float(form[3])
    except ValueError:
        raise MethodError(
            f"--knock: expected device, turn and shift, as c2:0.05deg:0.1mm, found '{text}'"
        ) from None


def parse_axis_off(text: str, /) -> tuple[float, float]:
    """Return mm and degrees of ``--axis-off``.

    Examples
    --------
    >>> parse_axis_off("5mm:2deg")
    (5.0, 2.0)
    """
    form = re.fullmatch(r"([\d.]+)mm:([\d.]+)deg", text)
    try:
        if form is None:
            raise ValueError
        return float(form[1]), float(form[2])
    except ValueError:
        raise MethodError(
            f"--axis-off: expected mm and degrees, as 5mm:2deg, found '{text}'"
        ) from None


def parse_tilts(text: str, /) -> tuple[float, ...]:
    """Return the tilts of ``--tilts``, degrees.

    Examples
    --------
    >>> parse_tilts("0,30")
    (0.0, 30.0)
    """
    try:
        tilts = tuple(float(part) for part in text.split(","))
    except ValueError:
        tilts = (math.nan,)
    if not all(abs(tilt) <= 90 for tilt in tilts):
        raise MethodError(
            f"--tilts: expected degrees from -90 to 90 with commas between, as 0,30, found '{text}'"
        )
    return tilts
