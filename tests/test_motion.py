"""Motion between the images: what it does to the phase, and what is left of that."""

from __future__ import annotations

import numpy as np
import pytest

import closed_form
from fringe3d.decode import drift_of, stilled
from fringe3d.model import ImageStack
from moving_scene import (
    MATT,
    PERIODS_PER_MM,
    drifting,
    error_of,
    moving_stack,
)


@pytest.fixture(autouse=True)
def _matt(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plaster ball, a white plane: a texture that moves through the pixels is another thing."""
    monkeypatch.setattr(closed_form, "_albedo", lambda points: np.full(points.shape[:-1], MATT))


@pytest.mark.parametrize(
    ("n_images", "drift", "less"),
    [(4, 0.05, 4), (4, 0.2, 4), (4, -0.2, 4), (8, 0.2, 6), (8, -0.2, 6)],
)
def test_the_error_of_motion_falls_fourfold_and_sixfold(
    n_images: int, drift: float, less: float
) -> None:
    """Negative drifts make the steps larger, positive ones smaller: four images then say little,
    and the noise of the best estimate alone, the drift known, is a fourth of what motion does."""
    errors = drifting(n_images, drift)
    assert errors.stilled < errors.moving / less


def test_a_texture_is_no_offset_for_its_neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where neighbours differ they say nothing of a pixel, and nothing gets worse by them."""
    monkeypatch.undo()
    for drift in (0.05, 0.2):
        errors = drifting(4, drift)
        assert errors.stilled < errors.moving / 2


def test_a_still_scene_is_returned_as_it_is() -> None:
    for n_images in (4, 8):
        stack, phase, usable = moving_stack(n_images, 0.0)
        assert stilled(stack) is stack
        assert error_of(stack, phase, usable) < 0.03  # noise alone


@pytest.mark.parametrize("drift", [-0.15, -0.04, 0.04, 0.1])
def test_the_drift_is_found_with_its_sign(drift: float) -> None:
    stack, _, usable = moving_stack(4, drift / PERIODS_PER_MM)
    moments = np.arange(4, dtype=np.float64) - 1.5
    found = drift_of(stack.images.astype(np.float32), stack.plan.fringe_sets[0], moments)
    # 5 %: the drift differs so much from the median over the depths of the scene.
    assert np.median(found[usable]) == pytest.approx(2 * np.pi * drift, rel=0.05)


def test_images_in_another_order_of_time_have_the_same_drift() -> None:
    """A window that slides: the newest image is not the last of the plan."""
    stack, _, usable = moving_stack(4, 0.5)
    times = (4, 5, 2, 3)  # images 0 and 1 are newer
    later = moving_stack(8, 0.5)[0]
    images = later.images[[4, 5, 2, 3]]
    fringes = stack.plan.fringe_sets[0]
    moments = np.array(times, np.float64) - np.mean(times)
    found = drift_of(images.astype(np.float32), fringes, moments)
    assert np.median(found[usable]) == pytest.approx(2 * np.pi * 0.5 * PERIODS_PER_MM, rel=0.05)


def test_a_small_part_that_moves_leaves_the_rest_as_it_is() -> None:
    still, moving = moving_stack(4, 0.0)[0], moving_stack(4, 0.6)[0]
    images = still.images.copy()
    images[:, 60:120, 60:120] = moving.images[:, 60:120, 60:120]
    mixed = ImageStack(images=images, plan=still.plan, device_name="c1", saturation_dn=255.0)
    found = stilled(mixed)
    assert found.sigma_growth is not None
    grown = found.images.astype(float) / 256 - images
    far = np.ones(still.shape, bool)
    far[45:135, 45:135] = False
    assert np.abs(grown[:, far]).mean() < 0.1  # windows across the border may be wrong
    assert np.abs(grown[:, 70:110, 70:110]).mean() > 2
