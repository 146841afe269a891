"""The fine structure of a surface's brightness, against plain filters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from fringe3d.health._contrast import fine_contrast
from fringe3d.health.texture import TextureTile

SHAPE = (37, 53)
BINOMIAL = np.array([1, 4, 6, 4, 1]) / 16


def test_fine_contrast_is_the_smoothed_brightness_less_its_slow_part() -> None:
    rng = np.random.default_rng(1)
    bright = rng.normal(size=SHAPE).astype(np.float32)
    bright[10, 20] = np.nan
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    slow = 0.3 * rows - 0.2 * cols + 0.01 * rows * cols  # linear between the centres of blocks
    at = (np.arange(10) + 0.5) * 4 - 0.5, (np.arange(14) + 0.5) * 4 - 0.5
    blocks = 0.3 * at[0][:, None] - 0.2 * at[1] + 0.01 * at[0][:, None] * at[1]
    found = np.empty(SHAPE, np.float32)
    fine_contrast(bright, blocks.astype(np.float32), np.float32(4), found, (0, len(bright)))
    smooth = bright.astype(np.float64)
    for axis in (0, 1):
        smooth = ndimage.correlate1d(smooth, BINOMIAL, axis=axis)
    lit = ndimage.binary_erosion(np.isfinite(bright), np.ones((7, 7), bool))
    assert np.array_equal(np.isfinite(found), lit)
    assert found[lit] == pytest.approx((smooth - slow)[lit], abs=1e-5)


def test_low_peaks_that_rival_each_other_accuse_nothing() -> None:
    """A clear match beside the curve does; two maxima of one smooth shading do not."""
    clear = TextureTile(here=0.1, best=0.6, best_shift=-40, rival=0.3)
    shading = TextureTile(here=-0.26, best=0.35, best_shift=24, rival=0.30)
    assert (clear.lies_elsewhere, shading.lies_elsewhere) == (True, False)
    assert not clear.agrees
    assert not shading.agrees
