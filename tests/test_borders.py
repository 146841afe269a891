"""Next to a border of what is measured an order is less certain than its evidence says."""

from __future__ import annotations

import numpy as np
import pytest

from fringe3d.correspond.borders import doubt_at_borders


@pytest.mark.parametrize("diagonal", [False, True])
def test_two_pixels_along_a_hole_are_in_doubt_and_no_others(diagonal: bool) -> None:
    rows, cols = np.mgrid[:20, :30]
    good = np.ones((20, 30), bool)
    good[10, 12] = False
    if diagonal:
        good[11, 13] = False
    away = np.full((20, 30), 99)
    for row, col in np.argwhere(~good):
        away = np.minimum(away, np.maximum(abs(rows - row), abs(cols - col)))
    given = np.float32(0.98)
    found = doubt_at_borders(np.full((20, 30), given), good)
    np.testing.assert_allclose(found[away == 1], 0.98 * (1 - 0.007), rtol=1e-6)
    np.testing.assert_allclose(found[away == 2], 0.98 * (1 - 0.0015), rtol=1e-6)
    assert (found[away > 2] == given).all()


def test_the_edge_of_the_image_is_no_border() -> None:
    ones = np.ones((5, 7), np.float32)
    np.testing.assert_array_equal(doubt_at_borders(ones, ones > 0), ones)
