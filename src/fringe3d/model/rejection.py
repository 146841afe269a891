"""Why a pixel has no point: one bit for each reason, the same everywhere."""

from __future__ import annotations

from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Rejection(IntFlag):
    """Reasons for which a pixel is rejected, in the order in which they are found.

    Where several bits are set, the lowest is the reason under which the pixel is counted.
    """

    SATURATED = 1 << 0
    LOW_MODULATION = 1 << 1
    INCONSISTENT_CODE = 1 << 2
    OUTSIDE_PROJECTOR = 1 << 3
    OUTSIDE_VIEW = 1 << 4
    NO_MATCH = 1 << 5
    AMBIGUOUS = 1 << 6
    RAYS_MISS = 1 << 7
    BEHIND_DEVICE = 1 << 8
    OUTSIDE_VOLUME = 1 << 9
    UNCERTAIN = 1 << 10
    ISOLATED = 1 << 11
    EDGE = 1 << 12
    SAME_POINT = 1 << 13
    HIDDEN = 1 << 14
    OUTLIER = 1 << 15
    REFLECTION = 1 << 16

    @property
    def meaning(self) -> str:
        """Return the reason in words."""
        return _MEANINGS[self]


_MEANINGS = {
    Rejection.SATURATED: "a fringe image is saturated here",
    Rejection.LOW_MODULATION: "too little fringe contrast: not lit, too dark, or blurred",
    Rejection.INCONSISTENT_CODE: "Gray code or periods contradict each other or the phase",
    Rejection.OUTSIDE_PROJECTOR: "the decoded position lies outside the projector image",
    Rejection.OUTSIDE_VIEW: "the viewing ray does not reach the second camera's view",
    Rejection.NO_MATCH: "no point with this phase on the segment: hidden, or outside the volume",
    Rejection.AMBIGUOUS: "several points on the epipolar segment fit",
    Rejection.RAYS_MISS: "the two rays pass each other too far apart",
    Rejection.BEHIND_DEVICE: "the rays meet behind a device, or not at all",
    Rejection.OUTSIDE_VOLUME: "the point lies outside the measuring volume",
    Rejection.UNCERTAIN: "the rays meet at so flat an angle that the point means nothing",
    Rejection.ISOLATED: "the point has no neighbours on its surface",
    Rejection.EDGE: "next to a depth edge, where light of two surfaces mixes "
    "(--drop-edges, --strict)",
    Rejection.SAME_POINT: "shares its projector pixel with neighbours: one point stands for all",
    Rejection.HIDDEN: "the surface itself hides the point from the second camera or the light",
    Rejection.OUTLIER: "off the surface of its neighbours by more than sigma explains (--outliers)",
    Rejection.REFLECTION: "cameras and projector disagree: light came by a second path, too "
    "(--reflections)",
}


def count_by_reason(rejection: NDArray[np.unsignedinteger[Any]]) -> dict[str, int]:
    """Count the pixels of each reason; every rejected pixel counts once.

    Parameters
    ----------
    rejection : (row, col) of unsigned integers, `Rejection` bits

    Returns
    -------
    dict of str to int
        Reasons that occur. Their sum is the number of pixels with any bit set.

    Examples
    --------
    >>> count_by_reason(np.array([[0, 3, 2]], np.uint16))
    {'SATURATED': 1, 'LOW_MODULATION': 1}
    """
    values = np.asarray(rejection, np.int32)
    lowest = values & -values
    counts = {reason.name or "": int((lowest == reason).sum()) for reason in Rejection}
    return {name: count for name, count in counts.items() if count}


def reject(
    rejection: NDArray[np.unsignedinteger[Any]], where: NDArray[np.bool_], reason: Rejection, /
) -> None:
    """Set the bit of `reason` in place where `where` is True.

    Phases and correspondences have 16 bits, points 32: what only points are rejected for is above.
    """
    rejection[where] |= rejection.dtype.type(reason)
