"""Light by a second path: cameras and projector disagree, and the point is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_form import Recording
from fringe3d.errors import MethodError
from fringe3d.model import ImageStack, Rejection, Rig, Scan
from fringe3d.model.rejection import count_by_reason
from fringe3d.pipeline import Measurement, MeasureOptions, measure

Bools = NDArray[np.bool_]

PLAIN = MeasureOptions(method="m1", blur_px=None)
LIGHT = replace(PLAIN, reflections="light")

PATCH = slice(110, 140), slice(150, 185)
"""Of C1, on the sphere."""

FROM_ROWS, FROM_COLS = 9, -61
"""Where the mirrored light of the patch comes from: px, so far that its fringes are other ones."""


def mirrored(scan: Scan, part: float) -> Scan:
    """Add light of elsewhere to a patch of C1, as from a mirror: all its images, the code too."""
    first, second = scan.stacks
    images = first.images.astype(np.float64)
    rows, cols = PATCH
    there = images[:, rows.start + FROM_ROWS : rows.stop + FROM_ROWS,
                   cols.start + FROM_COLS : cols.stop + FROM_COLS]  # fmt: skip
    images[:, rows, cols] += part * there
    return replace(scan, stacks=(with_images(first, images), second))


def with_images(stack: ImageStack, images: NDArray[np.float64]) -> ImageStack:
    return replace(stack, images=np.clip(images.round(), 0, 255).astype(np.uint8))


def left_out(result: Measurement) -> Bools:
    assert result.points is not None
    return np.asarray((result.points.rejection & np.uint32(Rejection.REFLECTION)) != 0)


def errors(result: Measurement, rig: Rig, recording: Recording) -> NDArray[np.float64]:
    """Return errors along the rays of C1, (row, col), mm."""
    assert result.points is not None
    true = recording[1][0].points_mm
    away = true - rig.cameras[0].center_world
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    return np.asarray(((result.points.points_mm - true) * away).sum(axis=-1))


def test_points_that_a_mirror_moves_are_left_out(rig: Rig, recording: Recording) -> None:
    """A fifth of other light moves the phase by up to 0.2 rad, twenty times its noise.

    Of the points that are off by more than six sigma 95 % go; without the filter the truth shows
    that the mirror moved them. Beside the patch means of 5 x 5 pixels take a rim of two with them:
    0.5 % of all points.
    """
    scan = mirrored(recording[0], 0.2)
    before, after = measure(scan, PLAIN), measure(scan, LIGHT)
    assert before.points is not None
    pull = np.abs(errors(before, rig, recording)) / before.points.sigma_mm
    inside = np.zeros(pull.shape, bool)
    inside[PATCH] = True
    wrong = inside & (pull > 6)
    assert wrong.sum() > 500
    assert left_out(after)[wrong].mean() > 0.95
    assert left_out(after)[~inside & before.points.is_valid].mean() < 0.006


def test_what_is_left_out_is_counted(recording: Recording) -> None:
    result = measure(mirrored(recording[0], 0.2), LIGHT)
    assert result.points is not None
    counts = count_by_reason(result.points.rejection)
    assert sum(counts.values()) + result.points.is_valid.sum() == result.points.rejection.size
    assert counts["REFLECTION"] == left_out(result).sum() > 0


def test_a_matt_scene_loses_nothing(recording: Recording) -> None:
    """Of 60,000 points; edges mix the light of two surfaces and may lose a few."""
    result = measure(recording[0], LIGHT)
    assert result.points is not None
    assert left_out(result).sum() < 1e-3 * result.points.is_valid.sum()


def test_one_camera_cannot_tell(rig: Rig, recording: Recording) -> None:
    alone = replace(recording[0], rig=replace(rig, projector=None))
    with pytest.raises(MethodError, match="--reflections: expected two cameras and a calibrated"):
        measure(alone, LIGHT)
