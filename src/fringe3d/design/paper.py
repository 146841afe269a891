"""Equations (1) to (5) of the source paper, as printed and exact.

The exact forms are those of C1's principal ray, for fringes square to the epipolar plane and
devices without distortion. What the calibrated rig does in every pixel is counted in `counts`.
Principal distances and periods may be in px or in mm, as long as both of a device are the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import brentq

MAX_SLOPE = math.radians(30.0)
"""Slope against C2's viewing direction up to which the shortest period is given."""

WIDEST_ANGLE = math.radians(89.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Depths:
    """The measuring volume along C1's principal ray, mm from C1.

    Parameters
    ----------
    depth_min_mm, depth_max_mm : float, mm; 0 < min < max
    depth_ref_mm : float, mm; of the reference point, at which all devices look

    Raises
    ------
    ValueError
        If the depths are not in this order.
    """

    depth_min_mm: float
    depth_ref_mm: float
    depth_max_mm: float

    def __post_init__(self) -> None:
        if not 0 < self.depth_min_mm <= self.depth_ref_mm <= self.depth_max_mm < math.inf:
            raise ValueError(
                "depths: expected 0 < depth_min_mm <= depth_ref_mm <= depth_max_mm, found "
                f"{self.depth_min_mm:g}, {self.depth_ref_mm:g} and {self.depth_max_mm:g}"
            )

    @property
    def relative_reach(self) -> float:
        """Return (d_0 - d_min)/d_min + (d_max - d_0)/d_max of equations (2) and (5)."""
        near, ref, far = self.depth_min_mm, self.depth_ref_mm, self.depth_max_mm
        return (ref - near) / near + (far - ref) / far


def nominal_period(period_p: float, focal_p: float, focal_c2: float, /) -> float:
    """Return the period in C2 on a surface that faces C2 and P alike: lambda_P c_C2 / c_P.

    Examples
    --------
    >>> nominal_period(16.0, 3200.0, 2400.0)
    12.0
    """
    return period_p * focal_c2 / focal_p


def shortest_period_printed(
    period_p: float, focal_p: float, focal_c2: float, angle_c2p: float, depths: Depths, /
) -> float:
    """Return equation (1) as printed, the shortest period that C2 may see.

    ``lambda_C2,min = lambda_P c_C2 / c_P - tan(tau_C2P) c_C2 (d_max - d_min) / d_min``

    It lets the depth jump through the whole range within one period. So it is positive only
    where the range moves the light by less than one period, and says nothing elsewhere.

    Parameters
    ----------
    period_p, focal_p : float; period and principal distance of the projector, px or mm
    focal_c2 : float; principal distance of C2, px or mm
    angle_c2p : float, rad; triangulation angle between C2 and P
    depths : Depths

    Returns
    -------
    float, in the unit of `focal_c2`; zero or negative where the equation does not hold

    Examples
    --------
    >>> depths = Depths(depth_min_mm=320, depth_ref_mm=335, depth_max_mm=350)
    >>> ratio = shortest_period_printed(0.32, 64.3, 1.0, math.radians(13.6), depths)
    >>> round(ratio / nominal_period(0.32, 64.3, 1.0), 2)
    -3.56
    """
    jump = (depths.depth_max_mm - depths.depth_min_mm) / depths.depth_min_mm
    return nominal_period(period_p, focal_p, focal_c2) - math.tan(angle_c2p) * focal_c2 * jump


def shortest_period_exact(
    period_p: float,
    focal_p: float,
    focal_c2: float,
    angle_c2p: float,
    distance_p_mm: float,
    distance_c2_mm: float,
    /,
    *,
    max_slope: float = MAX_SLOPE,
) -> float:
    """Return the shortest period that C2 sees on a smooth surface of limited slope.

    ``lambda_P (c_C2 / D_C2) / (c_P / D_P) cos(beta) / cos(beta - tau_C2P)`` at beta = max_slope,
    beta the angle of the surface normal against C2's viewing direction, positive towards P. The
    quotient falls with beta, so that the steepest slope towards P has the shortest period.

    Parameters
    ----------
    period_p, focal_p, focal_c2, angle_c2p : see `shortest_period_printed`
    distance_p_mm, distance_c2_mm : float, mm; of P and C2 from the reference point
    max_slope : float, rad, 0 to pi/2

    Returns
    -------
    float, in the unit of `focal_c2`; positive

    Examples
    --------
    >>> round(shortest_period_exact(16, 3200, 2400, 0.0, 335, 335), 3)
    12.0
    """
    facing = nominal_period(period_p, focal_p, focal_c2) * distance_p_mm / distance_c2_mm
    return facing * math.cos(max_slope) / math.cos(max_slope - angle_c2p)


def segment_length_printed(focal: float, angle: float, depths: Depths, /) -> float:
    """Return equation (2) as printed, the length of the epipolar segment.

    ``c_C2 ((d_0 - d_min) / d_min + (d_max - d_0) / d_max) tan(tau_C1C2)``

    It holds for parallel axes; between converging ones it is too long by about
    ``1 / cos(tau)**2`` at the near and less at the far end.

    Parameters
    ----------
    focal : float; principal distance of the device in which the segment lies, px or mm
    angle : float, rad; triangulation angle between C1 and that device
    depths : Depths

    Returns
    -------
    float, in the unit of `focal`
    """
    return focal * depths.relative_reach * math.tan(angle)


def segment_length_exact(
    focal: float, angle: float, depths: Depths, distance_mm: float, /
) -> float:
    """Return the exact length of the segment of C1's principal ray.

    ``c sin(tau) [e1 / (D + e1 cos(tau)) + e2 / (D - e2 cos(tau))]``, e1 = d_max - d_0,
    e2 = d_0 - d_min: the point at e behind the reference point lies ``e sin(tau)`` beside the
    other device's principal ray, at the distance ``D + e cos(tau)`` from it.

    Parameters
    ----------
    focal, angle, depths : see `segment_length_printed`
    distance_mm : float, mm; D, of the other device from the reference point

    Returns
    -------
    float, in the unit of `focal`

    Examples
    --------
    >>> depths = Depths(depth_min_mm=320, depth_ref_mm=335, depth_max_mm=350)
    >>> printed = segment_length_printed(1.0, math.radians(27), depths)
    >>> exact = segment_length_exact(1.0, math.radians(27), depths, 335.0)
    >>> round(printed / exact, 3)
    1.123
    """
    behind = depths.depth_max_mm - depths.depth_ref_mm
    before = depths.depth_ref_mm - depths.depth_min_mm
    along = math.cos(angle)
    reach = behind / (distance_mm + behind * along) + before / (distance_mm - before * along)
    return focal * math.sin(angle) * reach


def periods_printed(length: float, shortest_period: float, /) -> float:
    """Return equation (3) as printed, m = len(s) / lambda_C2,min; NaN where (1) does not hold.

    Examples
    --------
    >>> periods_printed(48.0, 12.0), periods_printed(48.0, -40.0)
    (4.0, nan)
    """
    return length / shortest_period if shortest_period > 0 else math.nan


def gray_bits_printed(periods: float, /) -> int:
    """Return equation (4) as printed, n with 2**(n-1) < m <= 2**n; 0 up to one period.

    It counts a segment of m periods as m orders. There are up to floor(m) + 1, for a period may
    be cut at both ends, and more within the uncertainty of the calibration.

    Raises
    ------
    ValueError
        If `periods` is not a positive finite number.

    Examples
    --------
    >>> [gray_bits_printed(m) for m in (0.9, 2.0, 2.1, 4.0, 4.1)]
    [0, 1, 2, 2, 3]
    """
    if not 0 < periods < math.inf:
        raise ValueError(f"periods: expected a positive finite number, found {periods}")
    return max(0, math.ceil(math.log2(periods)))


def angle_for_one_period_printed(period_p: float, focal_p: float, depths: Depths, /) -> float:
    """Return equation (5) as printed, the angle tau_C1P at which a segment holds one period.

    ``tan(tau_C1P) = (lambda_P / c_P) / ((d_0 - d_min) / d_min + (d_max - d_0) / d_max)``

    Parameters
    ----------
    period_p, focal_p : float; period and principal distance of the projector, px or mm
    depths : Depths

    Returns
    -------
    float, rad; infinite where the volume has no depth

    Examples
    --------
    >>> depths = Depths(depth_min_mm=320, depth_ref_mm=335, depth_max_mm=350)
    >>> round(math.degrees(angle_for_one_period_printed(0.32, 64.3, depths)), 2)
    3.17
    """
    reach = depths.relative_reach
    return math.atan(period_p / focal_p / reach) if reach > 0 else math.inf


def angle_for_one_period_exact(
    period_p: float, focal_p: float, depths: Depths, distance_p_mm: float, /
) -> float:
    """Return the angle tau_C1P at which the exact segment of C1's principal ray is one period.

    Parameters
    ----------
    period_p, focal_p, depths : see `angle_for_one_period_printed`
    distance_p_mm : float, mm; of P from the reference point

    Returns
    -------
    float, rad; infinite where no angle up to 89 deg gives a whole period

    Examples
    --------
    >>> depths = Depths(depth_min_mm=320, depth_ref_mm=335, depth_max_mm=350)
    >>> round(math.degrees(angle_for_one_period_exact(0.32, 64.3, depths, 335.0)), 2)
    3.18
    """

    def excess(angle: float) -> float:
        return segment_length_exact(focal_p, angle, depths, distance_p_mm) - period_p

    if excess(WIDEST_ANGLE) <= 0:
        return math.inf
    return float(brentq(excess, 0.0, WIDEST_ANGLE, xtol=1e-10))
