"""Points that C1 and the projector place, against the surface's closed form and C1 with C2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from changed_rigs import turned
from closed_phases import PLANE, Surface, grid_of, phase_map, seen_points, small_rig, visible
from fringe3d.correspond import TwoViews, choose_orders, match_cameras, place_lost
from fringe3d.correspond.chosen import ChosenOrders
from fringe3d.model import Correspondences, PointMap, Rejection, Rig
from fringe3d.triangulate import triangulate

pytestmark = pytest.mark.usefixtures("one_thread")

STD_RAD = 0.01


def views_of(rig: Rig, surface: Surface, *, noisy: bool = True) -> TwoViews:
    assert rig.projector is not None
    rng = np.random.default_rng(7) if noisy else None
    one, two = (phase_map(c, rig.projector, surface, n_classes=None, std=STD_RAD, rng=rng)
                for c in rig.cameras)  # fmt: skip
    return TwoViews(camera1=rig.cameras[0], camera2=rig.cameras[1], phases1=one, phases2=two)


def measured(rig: Rig, views: TwoViews) -> tuple[ChosenOrders, Correspondences]:
    """Return the orders that a rig chooses, and what it finds in C2."""
    assert rig.projector is not None
    assert rig.volume is not None
    chosen = choose_orders(views, rig.projector, rig.volume)
    known = views.phases1.rejecting(chosen.phases.rejection)
    return chosen, match_cameras(known, views.phases2, rig.cameras[0], rig.cameras[1], rig.volume)


def without(matches: Correspondences, reason: Rejection) -> Correspondences:
    """Return the same after the search in C2 failed everywhere."""
    rejection = np.where(matches.rejection == 0, np.uint16(reason), matches.rejection)
    return replace(matches, rejection=rejection, pixels=np.full_like(matches.pixels, np.nan),
                   order_probability=None)  # fmt: skip


def filled(rig: Rig, matches: Correspondences, chosen: ChosenOrders) -> Correspondences:
    camera1, camera2 = rig.cameras
    assert rig.projector is not None
    return place_lost(matches, chosen, camera1, camera2, rig.projector)


def placed(rig: Rig, matches: Correspondences, chosen: ChosenOrders) -> PointMap:
    camera1, camera2 = rig.cameras
    return triangulate(filled(rig, matches, chosen), camera1, camera2)


def errors_of(rig: Rig, points: PointMap, truth: np.ndarray) -> np.ndarray:
    """Return signed errors along the viewing rays, (row, col) mm."""
    camera = rig.cameras[0]
    away = truth - camera.center_world
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    return np.asarray(((points.points_mm - truth) * away).sum(axis=-1))


@pytest.mark.parametrize("reason", [Rejection.NO_MATCH, Rejection.AMBIGUOUS])
def test_lost_points_lie_on_the_surface_with_their_sigma(reason: Rejection) -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    chosen, matches = measured(rig, views_of(rig, PLANE))
    points = placed(rig, without(matches, reason), chosen)
    seen = visible(rig, PLANE) & points.is_valid
    assert seen.sum() > 0.97 * visible(rig, PLANE).sum()
    truth, _, _ = seen_points(rig.cameras[0], grid_of(rig.cameras[0]), PLANE)
    error = errors_of(rig, points, truth)[seen]
    # Noise alone; sigma also holds the scatter of the bias, at least 0.04 px, which is not there.
    noise = STD_RAD / (2 * np.pi) * 16.0
    bound = np.median(points.sigma_mm[seen] * noise / chosen.place_sigma_px[seen])
    assert np.std(error) == pytest.approx(bound, rel=0.05)
    assert np.abs(np.mean(error)) < 0.2 * bound
    assert np.median(points.sigma_mm[seen]) > bound


def test_what_the_search_found_stays_as_it_is() -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    chosen, matches = measured(rig, views_of(rig, PLANE))
    half = without(matches, Rejection.NO_MATCH)
    rejection = matches.rejection.copy()
    rejection[::2] = half.rejection[::2]
    pixels = np.where((rejection == 0)[..., None], matches.pixels, np.nan)
    mixed = replace(matches, rejection=rejection, pixels=pixels, order_probability=None)
    found = filled(rig, mixed, chosen)
    kept = rejection == 0
    np.testing.assert_array_equal(found.pixels[kept], matches.pixels[kept])
    np.testing.assert_array_equal(found.sigma_px[kept], matches.sigma_px[kept])
    assert (found.rejection[::2] == 0).mean() > 0.5


def test_pixels_without_an_order_stay_lost() -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    chosen, matches = measured(rig, views_of(rig, PLANE))
    none = replace(
        chosen,
        phases=chosen.phases.rejecting(
            np.full_like(matches.rejection, np.uint16(Rejection.AMBIGUOUS))
        ),
    )
    lost = without(matches, Rejection.NO_MATCH)
    found = filled(rig, lost, none)
    np.testing.assert_array_equal(found.rejection, lost.rejection)
    outside = without(matches, Rejection.OUTSIDE_VIEW)
    found = filled(rig, outside, chosen)
    assert (found.rejection[matches.rejection == 0] == Rejection.OUTSIDE_VIEW).all()


def test_the_bias_moves_them_to_where_the_cameras_would_put_them() -> None:
    """The projector is calibrated wrongly; both cameras, without it, are not."""
    true = small_rig(projector_azimuth_deg=-18.0)
    assert true.projector is not None
    surface = Surface()
    views = views_of(true, surface, noisy=False)
    wrong = replace(true, projector=turned(true.projector, "y", 0.01))
    chosen, _ = measured(wrong, views)
    _, matches = measured(true, views)
    by_cameras = triangulate(matches, true.cameras[0], true.cameras[1])
    points = placed(wrong, without(matches, Rejection.NO_MATCH), chosen)
    unbiased = replace(chosen, place_px=np.zeros_like(chosen.place_px))
    raw = placed(wrong, without(matches, Rejection.NO_MATCH), unbiased)
    both = points.is_valid & raw.is_valid & by_cameras.is_valid
    assert both.sum() > 10_000
    near, far = (
        float(np.median(np.linalg.norm(p.points_mm - by_cameras.points_mm, axis=-1)[both]))
        for p in (points, raw)
    )
    assert far > 0.1
    assert near < 0.1 * far
