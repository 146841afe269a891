"""The sums behind the benchmark of fringe orders, against what can be said in closed form."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
if not (ROOT / "benchmarks" / "orders").is_dir():
    pytest.skip("the benchmarks are not part of this distribution", allow_module_level=True)
sys.path.append(str(ROOT))

from benchmarks.orders.figures import DOUBT_EDGES, Counts, pooled, reliability, total  # noqa: E402
from benchmarks.orders.voting import Unwrapping, by_library, grown, winners  # noqa: E402


def test_honest_probabilities_have_no_calibration_error() -> None:
    """Of n points with doubt q exactly n q are wrong."""
    probability = np.repeat([0.5, 0.9, 0.99], [10, 100, 1000])
    is_right = np.concatenate([np.arange(n) >= n * q for n, q in ((10, 0.5), (100, 0.1))])
    is_right = np.concatenate([is_right, np.arange(1000) >= 10])
    found = reliability(probability, is_right)
    assert found.calibration_error == pytest.approx(0, abs=1e-12)
    assert found.beyond(0.9) == pytest.approx((1100, 20, 20))
    assert found.beyond(0.99) == pytest.approx((1000, 10, 10))


def test_calibration_error_is_how_much_too_sure_points_are() -> None:
    """Doubt q where a part w is wrong: |w - q|, weighted by the number of points."""
    sure, doubtful = np.full(300, 0.999), np.full(100, 0.6)
    is_right = np.concatenate([np.arange(300) >= 30, np.arange(100) >= 10])
    found = reliability(np.concatenate([sure, doubtful]), is_right)
    assert found.calibration_error == pytest.approx((300 * (0.1 - 0.001) + 100 * (0.4 - 0.1)) / 400)


def test_pooled_points_are_those_of_all_together() -> None:
    rng = np.random.default_rng(1)
    probability = 1 - 10 ** rng.uniform(-8, 0, 1000)
    is_right = rng.random(1000) < probability
    parts = [reliability(probability[i::3], is_right[i::3]) for i in range(3)]
    whole, together = reliability(probability, is_right), pooled(parts)
    for name in ("points", "wrong", "doubt"):
        np.testing.assert_allclose(getattr(together, name), getattr(whole, name))
    assert whole.points.sum() == 1000
    assert len(whole.points) == len(DOUBT_EDGES) - 1


def test_shares_are_relative_to_m1_and_to_the_reference() -> None:
    one = Counts(reference=200, m1_right=160, right=152, wrong=1, false=4)
    assert one.completeness == 95
    assert (one.of_reference("wrong"), one.of_reference("false")) == (0.5, 2)
    assert total([one, one]).shares() == one.shares()
    assert np.isnan(Counts().completeness)


@pytest.mark.parametrize("unwrapping", [grown, by_library])
def test_unwrapping_recovers_a_smooth_phase_up_to_one_shift_for_each_region(
    unwrapping: Unwrapping,
) -> None:
    rows, cols = np.mgrid[:40, :90].astype(float)
    absolute = 0.9 * cols + 0.002 * rows**2
    valid = cols != 45
    turns = np.rint(absolute / (2 * np.pi)).astype(int)
    found, region = unwrapping(absolute - 2 * np.pi * turns, valid)
    left = (cols < 45)[valid]
    for side in (left, ~left):
        assert len(np.unique(region[side])) == 1
        assert len(np.unique(turns[valid][side] - found[side])) == 1
    assert region[left][0] != region[~left][0]


def test_the_vote_goes_to_the_shift_with_most_support() -> None:
    region, shift = np.array([0, 0, 1, 1, 1]), np.array([3, 4, -1, -1, 2])
    best, certainty = winners(region, shift, np.array([2.0, 1.0, 0.5, 0.5, 0.9]), n_regions=3)
    assert best[:2].tolist() == [3, -1]
    expected = [1 / (1 + np.exp(-1)), 1 / (1 + np.exp(-0.1))]
    np.testing.assert_allclose(certainty[:2], expected)
