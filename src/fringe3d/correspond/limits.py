"""What candidates are weighed by."""

from __future__ import annotations

import numpy as np

TWO_PI = 2 * np.pi

OUTSIDE_COST = 6.0
"""Half squared deviations by which a surface outside the volume must fit better (3.5 of them). A
whole surface has far more evidence than that, a few stray pixels have not."""

LARGEST_COST = HIDDEN_COST = 1.2
"""Half squared deviations of one pixel, among its neighbours: more is an edge or a reflection.
Something that hides one pixel from C2 hides its neighbours, too: it must not cost more."""


UNSEEN_COST = 12.0
"""Squared deviations, where pixels decide alone: a candidate that C2 does not see is as good as one
that it sees 3.5 standard deviations off."""

LARGEST_EXTRA = 6.0
"""The same for other fringes, whose light nothing hides from the projector."""

MOST_SIGMA = 1 / 12
"""Turns; residuals that are less certain reject nothing: six deviations are half a turn."""

SAMPLE = 2000
"""Pixels that show in which direction the phase rises, and how far apart candidates are."""

CLEAR = 0.99
"""Probability of the decisions from which the bias is learnt."""

EXPECTED_CALIBRATION_PX = 0.3
"""Of C2; what a good rig's calibration may be wrong by before its bias is known."""

PROJECTOR_CALIBRATION_PX = 0.5
"""Projector px, in a second fringe direction."""
