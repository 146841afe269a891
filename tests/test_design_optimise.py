"""Places of the projector: named, screened, found; and what the command says about them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from fringe3d.cli import optimiser
from fringe3d.cli.console import Reporter
from fringe3d.cli.optimiser import recommendation, table
from fringe3d.decode import wrapped_phase
from fringe3d.design.counts import angle_without_code, periods_on_projector
from fringe3d.design.margin import ambiguity_margins, sloping_normals
from fringe3d.design.optimise import Candidate, Optimisation, optimise
from fringe3d.design.reference import reference_of
from fringe3d.design.residual import Quality, wrong_order_residuals
from fringe3d.design.screen import screen
from fringe3d.design.search import Kind, Limits, Task, refine, survey
from fringe3d.design.stand import stand_of
from fringe3d.design.uncertainty import phase_noise, predict_uncertainty
from fringe3d.errors import RigError
from fringe3d.geometry import above, looking_at_origin, pixel_grid
from fringe3d.io.rigfile import read_rig
from fringe3d.model import Device, MeasuringVolume, PatternPlan, Rig
from fringe3d.model.plan import fringes

pytest.importorskip("embreex")

from fringe3d.simulate import OBJECTS, PRESETS, Setup, prepare, record

Floats = NDArray[np.float64]

PERIOD = 16.0
COARSE = Limits(spacing=math.radians(10.0), n_starts=1)
QUALITY = Quality()


@pytest.fixture(scope="module")
def kolibri() -> Rig:
    return PRESETS["kolibri"]((640, 512)).rig


@pytest.fixture(scope="module")
def found(kolibri: Rig) -> Optimisation:
    return optimise(kolibri, period_px=PERIOD, slopes_deg=(0.0, 20.0, 40.0), limits=COARSE)


def by_name(found: Optimisation, name: str) -> Candidate:
    return next(c for c in found.candidates if c.name == name)


def grid(rig: Rig, step: int) -> Floats:
    return pixel_grid(rig.cameras[0].shape)[step // 2 :: step, step // 2 :: step].reshape(-1, 2)


def opencv_pixels(device: Device, points: Floats) -> Floats:
    pose = device.device_from_world
    seen, _ = cv2.projectPoints(
        points.reshape(-1, 3), cv2.Rodrigues(pose.rotation)[0], pose.translation.reshape(3, 1),
        device.camera_matrix, device.distortion,
    )  # fmt: skip
    return np.array(seen, np.float64).reshape(-1, 2)


@pytest.mark.parametrize("place", [(30.0, 23.0), (0.0, 0.0), (12.0, -140.0)])
def test_places_are_named_as_those_of_the_presets(kolibri: Rig, place: tuple[float, float]) -> None:
    stand = stand_of(kolibri)
    moved = stand.placed(kolibri, *np.radians(place))
    assert moved.projector is not None
    wanted = looking_at_origin(above(*place, 335.0))
    np.testing.assert_allclose(moved.projector.device_from_world.rotation, wanted.rotation,
                               atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(moved.projector.center_world, above(*place, 335.0), atol=1e-6)
    tilt, azimuth = np.degrees(stand.angles_of(moved.projector))
    assert tilt == pytest.approx(place[0], abs=1e-6)
    if place[0]:
        assert azimuth == pytest.approx(place[1], abs=1e-6)


def test_a_moved_projector_keeps_distance_aim_and_roll(kolibri: Rig) -> None:
    """The reference point stays where it was in the projector's image; a place and back is none."""
    assert kolibri.projector is not None
    rolled = replace(
        kolibri.projector,
        device_from_world=replace_rotation(kolibri.projector, [0.02, -0.03, 0.7]),
    )
    rig = replace(kolibri, projector=rolled)
    stand = stand_of(rig)
    point = stand.point_mm
    moved = stand.placed(rig, 0.5, -2.0)
    assert moved.projector is not None
    before, after = (opencv_pixels(device, point)[0] for device in (rolled, moved.projector))
    np.testing.assert_allclose(after, before, atol=1e-6)
    back = stand.placed(moved, *stand.angles_of(rolled))
    assert back.projector is not None
    np.testing.assert_allclose(back.projector.device_from_world.rotation,
                               rolled.device_from_world.rotation, atol=1e-9)  # fmt: skip
    distance = np.linalg.norm(moved.projector.center_world - point)
    assert distance == pytest.approx(float(np.linalg.norm(rolled.center_world - point)))


def replace_rotation(device: Device, turn: list[float]):  # type: ignore[no-untyped-def]
    rotation = cv2.Rodrigues(np.array(turn))[0] @ device.device_from_world.rotation
    return replace(
        device.device_from_world, rotation=rotation, translation=-rotation @ device.center_world
    )


def test_the_separation_is_that_of_the_nearest_camera(kolibri: Rig) -> None:
    """13.6 deg to both, as in the source paper; (30, 23) deg stands 4.8 deg from C2."""
    stand = stand_of(kolibri)
    assert math.degrees(stand.separation(kolibri)) == pytest.approx(13.6, abs=0.05)
    towards = [above(30, 23, 1.0) @ above(27, azimuth, 1.0) for azimuth in (-31, 31)]
    moved = stand.placed(kolibri, *np.radians([30.0, 23.0]))
    assert stand.separation(moved) == pytest.approx(math.acos(max(towards)), abs=1e-6)


def test_a_rig_without_a_table_stands_on_what_it_faces(kolibri: Rig) -> None:
    slab = MeasuringVolume.depth_slab(kolibri.cameras[0], depth_min_mm=320, depth_max_mm=350)
    facing = reference_of(replace(kolibri, volume=slab)).facing
    np.testing.assert_allclose(stand_of(replace(kolibri, volume=slab)).upright, facing)
    box = MeasuringVolume.box([-30, -30, -10], [30, 30, 10])
    assert stand_of(replace(kolibri, volume=box)).upright.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("place", "angle_deg"), [((30, 23), 0.0), ((30, 23), 45.0), ((33, 0), -45.0), ((24, 44), 45.0)]
)
def test_screening_agrees_with_the_exact_margins(
    kolibri: Rig, place: tuple[float, float], angle_deg: float
) -> None:
    """To first order, on the same pixels and surfaces: 3 %."""
    rig = stand_of(kolibri).placed(kolibri, *np.radians(place))
    angle = math.radians(angle_deg)
    facing = reference_of(kolibri).facing
    normals = np.vstack([facing, sloping_normals(rig, facing, math.radians(20), 8)])
    quick = screen(rig, grid(rig, 90), np.array([0.3, angle]), normals, QUALITY, period_px=PERIOD)
    exact = ambiguity_margins(rig, period_px=PERIOD, angle=angle, slopes_deg=(0, 20), step_px=90,
                              depths=(0, 0.5, 1))  # fmt: skip
    assert quick.ratio[1] == pytest.approx(exact.worst_ratio[1], rel=0.03)
    sigma = predict_uncertainty(rig, period_px=PERIOD, sigma_phase=phase_noise(4, 0.01),
                                angle=angle, step=32)  # fmt: skip
    assert quick.sigma_mm[1] == pytest.approx(sigma.median_mm, rel=0.02)
    periods = periods_on_projector(rig, period_px=PERIOD, angle=angle, step=4)
    assert quick.reach[1] == pytest.approx(float(np.nanmax(periods)), rel=0.12)  # coarser pixels


def test_screening_tells_a_zero_line(kolibri: Rig) -> None:
    facing = reference_of(kolibri).facing
    normals = np.vstack([facing, sloping_normals(kolibri, facing, math.radians(20), 8)])
    quick = screen(kolibri, grid(kolibri, 90), np.array([0.0]), normals, QUALITY, period_px=PERIOD)
    assert quick.ratio[0] < 0


def test_fringes_along_the_epipolar_lines_leave_no_periods(kolibri: Rig) -> None:
    """The direction, in the projector, of the image of C1's ray, drawn with OpenCV."""
    rig = stand_of(kolibri).placed(kolibri, *np.radians([15.0, -20.0]))
    assert rig.projector is not None
    towards = rig.cameras[0].center_world / 335
    ends = [opencv_pixels(rig.projector, s * towards)[0] for s in (-10.0, 10.0)]
    line = ends[1] - ends[0]
    along = math.atan2(-line[0], line[1])  # w does not change along the line
    angles = along + np.radians([0.0, 10.0, 90.0])
    normals = reference_of(rig).facing[None]
    quick = screen(rig, grid(rig, 90), angles, normals, QUALITY, period_px=PERIOD)
    assert quick.reach[0] < 0.15  # lines of other pixels fan out by a degree
    assert quick.reach[0] < quick.reach[1] < quick.reach[2]
    assert quick.reach[2] == pytest.approx(np.linalg.norm(line) / PERIOD * 28 / 20, rel=0.15)


def test_four_images_are_found_to_be_enough(found: Optimisation) -> None:
    best = found.best
    assert best.is_enough
    assert best.ratio >= 6
    assert best.n_images == 4
    assert not len(best.margins.orders)
    assert best.price < 1.5  # 1.1 with a finer search
    assert best.sigma_mm == pytest.approx(best.price * found.given.sigma_mm)
    given = found.given
    assert not given.is_enough
    assert given.n_images == 4 + 3  # two bits and the over-determined one
    assert given.ratio == 0


def test_all_candidates_but_the_papers_keep_the_limits(found: Optimisation) -> None:
    for candidate in found.candidates[1:]:
        separation = found.stand.separation(candidate.rig)
        assert candidate.separation == pytest.approx(separation)
        if candidate.name == "next to C1":
            assert not candidate.is_allowed
            continue
        assert candidate.is_allowed
        assert candidate.price <= 1.501
        if candidate.name != "turned":  # the given place need not respect them
            assert separation >= math.radians(8.0) - 1e-3
            assert candidate.tilt <= math.radians(35.0) + 1e-3
        assert found.limits is COARSE


@pytest.mark.parametrize(("kind", "limits"), [
    ("turned", Limits(spacing=0.2, n_starts=1, max_price=1.1)),
    ("moved and turned", Limits(spacing=0.2, n_starts=1, min_separation=math.radians(20.0))),
])  # fmt: skip
def test_narrow_limits_are_kept_while_places_are_refined(
    kolibri: Rig, kind: Kind, limits: Limits
) -> None:
    """Without them 1.16 times the standard deviation and 8 deg would be taken."""
    task = Task.of(kolibri, period_px=PERIOD, angle=0.0, slopes_deg=(20.0,), quality=QUALITY,
                   limits=limits, beyond=0.0)  # fmt: skip
    place = refine(task, kind, survey(task))
    assert place is not None
    assert place.is_moved == (kind != "turned")
    moved = task.stand.placed(kolibri, place.tilt, place.azimuth) if place.is_moved else kolibri
    sigma = predict_uncertainty(moved, period_px=PERIOD, sigma_phase=phase_noise(4, 0.01),
                                angle=place.angle, step=32)  # fmt: skip
    assert sigma.median_mm / task.sigma_mm <= limits.max_price + 1e-3
    if place.is_moved:
        assert task.stand.separation(moved) >= limits.min_separation - 1e-3
        assert place.tilt <= limits.max_tilt + 1e-3


def test_each_kind_changes_only_what_it_may(kolibri: Rig, found: Optimisation) -> None:
    assert kolibri.projector is not None
    assert by_name(found, "turned").rig is kolibri
    assert by_name(found, "turned").angle != 0
    assert by_name(found, "moved").angle == 0
    for candidate in found.candidates:
        assert candidate.rig.cameras == kolibri.cameras
        assert candidate.rig.volume is kolibri.volume
    free = by_name(found, "moved and turned")
    assert free.ratio >= max(by_name(found, n).ratio for n in ("turned", "moved")) - 0.1
    one = by_name(found, "one period")
    assert one.periods < 1
    assert one.price <= free.price + 0.01


def test_the_designed_preset_does_without_a_code() -> None:
    """As the optimiser promises: no wrong order, and enough certainty for slopes up to 40 deg."""
    preset = PRESETS["designed"]((640, 512))
    margins = ambiguity_margins(
        preset.rig, period_px=PERIOD, angle=preset.fringe_angle, slopes_deg=(0, 40), step_px=64
    )
    assert not len(margins.orders)
    assert margins.worst_ratio[-1] >= 6
    stand = stand_of(preset.rig)
    assert stand.separation(preset.rig) >= math.radians(8.0)


def test_the_papers_way_is_the_angle_without_code(kolibri: Rig, found: Optimisation) -> None:
    """As long as guard and the fringe period allow: max m + 2 guard = 1."""
    paper = by_name(found, "next to C1")
    guard = 3 * phase_noise(4, 0.01) / (2 * math.pi) + 0.1 / PERIOD
    assert paper.periods + 2 * guard == pytest.approx(1.0, abs=0.01)
    tau = angle_without_code(kolibri, period_px=PERIOD, guard=guard, step=8)
    assert paper.separation == pytest.approx(tau, abs=1e-6)


def test_a_bad_calibration_is_not_glossed_over(kolibri: Rig, tmp_path: Path) -> None:
    """With 0.5 px no place tells the orders apart, and that is said."""
    poor = Quality(calibration_px=0.5)
    coarser = Limits(spacing=math.radians(17.0), n_starts=1)
    found = optimise(kolibri, period_px=PERIOD, quality=poor, slopes_deg=(40.0,), limits=coarser)
    assert not found.best.is_enough
    assert all(c.n_images > 4 for c in found.candidates)
    said = recommendation(found, poor).replace("\n", " ")
    assert "No place was found where 4 images" in said
    assert "calibrate better than 0.5 px" in said
    assert "designed-rig.toml" not in optimiser.write_files(tmp_path, found)
    assert not (tmp_path / "designed-rig.toml").exists()


def test_what_is_missing_is_said(kolibri: Rig) -> None:
    for rig, what in (
        (replace(kolibri, cameras=kolibri.cameras[:1]), "two cameras"),
        (replace(kolibri, projector=None), "a projector"),
        (replace(kolibri, volume=None), "a measuring volume"),
    ):
        with pytest.raises(RigError, match=f"expected {what}"):
            optimise(rig, period_px=PERIOD)
    with pytest.raises(ValueError, match="limits: expected"):
        Limits(max_price=0.5)


def test_the_command_writes_the_rig_and_the_picture(
    kolibri: Rig, found: Optimisation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, object] = {}

    def known(_rig: Rig, **options: object) -> Optimisation:
        asked.update(options)
        return found

    monkeypatch.setattr(optimiser, "optimise", known)
    said = optimiser.run_optimise(kolibri, period_px=PERIOD, angle=0.3, quality=QUALITY,
                                  out=tmp_path, reporter=Reporter(quiet=True))  # fmt: skip
    assert (asked["period_px"], asked["angle"], asked["quality"]) == (PERIOD, 0.3, QUALITY)
    assert "0 given" in said
    assert "next to C1 *" in said
    assert "Recommended: one period" in said
    assert (tmp_path / "tradeoff.png").stat().st_size > 10_000
    rig = read_rig(tmp_path / "designed-rig.toml")
    assert rig.projector is not None
    tilt, azimuth = np.degrees(stand_of(rig).angles_of(rig.projector))
    assert f"tilt {tilt:.1f} deg, azimuth {azimuth:.1f} deg" in said.replace("\n", " ")
    assert rig.provenance.endswith("design --optimise")


def test_the_table_has_a_row_for_each_candidate(found: Optimisation) -> None:
    lines = table(found).splitlines()
    assert len(lines) == 2 + len(found.candidates)
    assert lines[2].split()[:4] == ["0", "given", "22.0", "0.0"]
    assert lines[2].split()[-1] == "7"
    assert "+-4" in lines[2]
    assert "none" in lines[-1]


def test_predicted_residuals_are_found_in_images() -> None:
    """A prism, the projector beside C2, true normals. Next to its edges, on one pixel of ten, C2
    looks past the facet that is predicted from."""
    preset = PRESETS["kolibri"]((320, 256))
    rig = stand_of(preset.rig).placed(preset.rig, *np.radians([30.0, 23.0]))
    assert rig.projector is not None
    stage = prepare(rig, preset.scene(OBJECTS["prism"]()), Setup(n_rays=1))
    plan = PatternPlan(patterns=fringes(PERIOD, 4), projector_shape=rig.projector.shape)
    stacks = record(stage, plan, seed=1).stacks
    first, second = (
        np.asarray(wrapped_phase(stack, stack.plan.fringe_sets[0]).phase / (2 * np.pi), np.float64)
        for stack in stacks
    )
    truth = stage.truths[0]
    usable = truth.lit & truth.in_volume & truth.seen_by["c2"] & np.isfinite(first)
    points, normals = truth.points_mm[usable][::50], truth.normals[usable][::50]
    for j in (1, -1):
        predicted = wrong_order_residuals(rig, points, normals, [j], period_px=PERIOD)[:, 0]
        off = seen_residuals(rig, points, first[usable][::50], second, j) - predicted
        off = np.abs(off - np.rint(off))[np.isfinite(off)]
        assert len(off) > 400
        assert np.median(off) < 0.005
        assert (off < 0.02).mean() > 0.85


def seen_residuals(rig: Rig, points: Floats, phase: Floats, phase2: Floats, j: int) -> Floats:
    """Return the phase of C2 where the wrong order leads less that of C1, (n,) periods."""
    assert rig.projector is not None
    eye = rig.cameras[0].center_world
    along = (points - eye) / np.linalg.norm(points - eye, axis=-1, keepdims=True)
    steps = np.linspace(-15, 15, 301)
    places = np.empty_like(points)
    for number, point in enumerate(points):
        u = opencv_pixels(rig.projector, point + steps[:, None] * along[number])[:, 0]
        periods = (u + 0.5) / PERIOD - phase[number]
        wanted = np.rint(np.interp(0.0, steps, periods)) + j
        up = 1 if periods[-1] > periods[0] else -1
        places[number] = point + np.interp(wanted, periods[::up], steps[::up]) * along[number]
    x, y = opencv_pixels(rig.cameras[1], places).T
    phasor = np.exp(2j * np.pi * phase2)
    real, imaginary = (
        map_coordinates(part, [y, x], order=1, cval=np.nan) for part in (phasor.real, phasor.imag)
    )
    return np.asarray(np.arctan2(imaginary, real) / (2 * np.pi) - phase)
