"""The 3D view: candidates of a pixel, and what a browser shows."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from browser import browser, pixels_of, watched_page
from fringe3d.cli import main
from fringe3d.cli.viewing import compared_with
from fringe3d.errors import MethodError
from fringe3d.geometry import frustum_lines, volume_lines
from fringe3d.io.rigfile import rig_text
from fringe3d.io.stored import StoredResult, angle_of, read_result
from fringe3d.model import Device, MeasuringVolume, PhaseMap, Rig, RigidTransform
from fringe3d.report.cloud_data import residual_px
from fringe3d.view.pace import Detail, levels_of
from fringe3d.view.pixel import nearest_pixel, pixel_story, residual_along
from fringe3d.view.segments import segment_picture
from fringe3d.view.shapes import grid_triangles, light_sheet
from stored_result import SHAPE, write_stored_result

PERIOD_PX = 16.0
CANVAS = "canvas:not([width='0'])"
"""There is an empty one, too."""
DISTORTION = [0.05, -0.02, 0.001, -0.001]


def device(name: str, role: Any, x_mm: float, turn_deg: float) -> Device:
    turn = np.radians(turn_deg)
    rotation = np.array(
        [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
    )
    pose = RigidTransform(rotation=rotation, translation=-rotation @ [x_mm, 0, 0])
    return Device(
        name=name,
        role=role,
        n_rows=SHAPE[0],
        n_cols=SHAPE[1],
        focal_px=[400, 400],
        center_px=[39.5, 29.5],
        distortion=DISTORTION,
        device_from_world=pose,
    )


def seen_by_opencv(of: Device, point: np.ndarray) -> np.ndarray:
    pose = of.device_from_world
    matrix = np.array([[400, 0, 39.5], [0, 400, 29.5], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(pose.rotation)
    pixels, _ = cv2.projectPoints(
        point.reshape(1, 1, 3), turn, pose.translation, matrix, np.array(DISTORTION)
    )
    return np.asarray(pixels).reshape(2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result whose points lie where its rig sees them; phases by OpenCV's projection."""
    made = write_stored_result(tmp_path_factory.mktemp("view") / "result")
    rig = Rig(
        cameras=(device("c1", "camera", 0, 0), device("c2", "camera", 60, -8.5)),
        projector=device("projector", "projector", -45, 6.4),
        volume=MeasuringVolume.box([-100, -100, 350], [100, 100, 450]),
    )
    (made / "rig.toml").write_text(rig_text(rig), encoding="utf-8")
    with np.load(made / "points.npz") as stored:
        maps = dict(stored)
    point = np.array([3.0, 2.0, 402.0])
    row, col = PIXEL
    maps["points_mm"] += [0, 0, 300]
    maps["points_mm"][PIXEL] = point
    turns = (seen_by_opencv(rig.devices[2], point)[0] + 0.5) / PERIOD_PX
    maps["absolute_phase"] = np.full(SHAPE, 2 * np.pi * turns)
    maps["fringe_order"] = np.full(SHAPE, int(turns), np.int32)
    np.savez(made / "points.npz", **maps)
    assert np.abs(seen_by_opencv(rig.devices[0], point) - [col, row]).max() < 0.5
    return made


PIXEL = (31, 42)


@pytest.fixture(scope="module")
def stored(folder: Path) -> StoredResult:
    return read_result(folder)


def test_the_taken_candidate_is_the_point(stored: StoredResult) -> None:
    """The viewing ray of the pixel passes the point by less than half a pixel, 0.5 mm there."""
    story = pixel_story(stored, *PIXEL)
    taken = [candidate for candidate in story.candidates if candidate.is_taken]
    assert len(taken) == 1
    np.testing.assert_allclose(taken[0].point_mm, [3.0, 2.0, 402.0], atol=6.0)
    rig = stored.rig
    assert rig is not None
    for seen_by in rig.devices[1:]:
        expected = seen_by_opencv(seen_by, taken[0].point_mm)
        np.testing.assert_allclose(taken[0].pixels[seen_by.name], expected, atol=1e-6)


def test_candidates_have_one_phase_and_lie_on_the_segment(stored: StoredResult) -> None:
    story = pixel_story(stored, *PIXEL)
    assert stored.rig is not None
    projector = stored.rig.devices[2]
    part = float(stored.maps["absolute_phase"][PIXEL]) / (2 * np.pi) % 1
    assert len(story.candidates) >= 1
    near, far = story.ends_mm
    for candidate in story.candidates:
        turns = (seen_by_opencv(projector, candidate.point_mm)[0] + 0.5) / PERIOD_PX
        assert turns == pytest.approx(candidate.order + part, abs=1e-6)
        along = (candidate.point_mm - near) @ (far - near) / ((far - near) @ (far - near))
        assert 0 <= along <= 1


def seen_phases(name: str, offset_rad: float, stored: StoredResult) -> PhaseMap:
    """Return what a camera sees that shows one phase everywhere: that of the pixel, and more."""
    phase = float(stored.maps["absolute_phase"][PIXEL]) + offset_rad
    nothing = np.zeros(SHAPE, np.float32)
    return PhaseMap(
        phase=np.full(SHAPE, phase % (2 * np.pi)), order_class=nothing.astype(int),
        class_of_order=np.zeros(1, np.int32), phase_std=nothing, offset=nothing, modulation=nothing,
        rejection=nothing.astype(int), period_px=PERIOD_PX, angle=0.0, device_name=name,
    )  # fmt: skip


@pytest.mark.parametrize("offset_rad", [0.3, -2.9, 2 * np.pi + 0.1])
def test_candidates_tell_by_how_much_they_miss(stored: StoredResult, offset_rad: float) -> None:
    phases = {"c2": seen_phases("c2", offset_rad, stored)}
    story = pixel_story(stored, *PIXEL, phases=phases)
    expected = (offset_rad / (2 * np.pi) + 0.5) % 1 - 0.5
    (taken,) = (candidate for candidate in story.candidates if candidate.is_taken)
    assert taken.residuals["c2"] == pytest.approx(expected, abs=1e-6)
    assert f"in c2 it misses by {abs(expected):.3f} periods" in story.words
    depths, residuals = residual_along(stored, story, phases["c2"])
    assert depths[0] < taken.depth_mm < depths[-1]
    np.testing.assert_allclose(residuals[np.isfinite(residuals)], expected, atol=1e-6)


def test_a_rejected_pixel_has_candidates_none_of_them_taken(stored: StoredResult) -> None:
    """Those of the same phase with a point; one more turn in the phase of C1 changes nothing."""
    rejection = stored.rejection.copy()
    rejection[PIXEL] = 1
    refused = replace(stored, maps=stored.maps | {"rejection": rejection})
    assert pixel_story(refused, *PIXEL).candidates == ()
    seen = {"c1": seen_phases("c1", 0.0, stored), "c2": seen_phases("c2", 0.3, stored)}
    with_point = pixel_story(stored, *PIXEL, phases=seen)
    story = pixel_story(refused, *PIXEL, phases=seen)
    assert story.words.startswith("no point: ")
    assert f"{len(story.candidates)} fringe orders fit its phase; in c2 order" in story.words
    assert not any(candidate.is_taken for candidate in story.candidates)
    assert [c.order for c in story.candidates] == [c.order for c in with_point.candidates]
    for own, other in zip(story.candidates, with_point.candidates, strict=True):
        # The phase of C1 is kept in single precision: 1e-6 of a turn, 0.1 um along the ray here.
        np.testing.assert_allclose(own.point_mm, other.point_mm, atol=1e-3)
        assert own.residuals["c2"] == pytest.approx(0.3 / (2 * np.pi), abs=1e-5)


def test_the_picture_of_the_segments_holds_the_candidates(stored: StoredResult) -> None:
    """One green mark, that of the order taken; none where the ray misses the volume."""
    phases = {"c2": seen_phases("c2", 0.3, stored)}
    story = pixel_story(stored, *PIXEL, phases=phases)
    picture = segment_picture(stored, story, phases)
    assert picture is not None
    is_green = (np.abs(picture.astype(int) - [0x1A, 0x9C, 0x3C]) < 12).all(axis=-1)
    is_red = (np.abs(picture.astype(int) - [0xD6, 0x30, 0x2A]) < 12).all(axis=-1)
    assert is_green.sum() > 100
    assert (is_red.sum() > 100) == (len(story.candidates) > 1)
    missed = replace(story, ends_mm=np.full((2, 3), np.nan))
    assert segment_picture(stored, missed, phases) is None


def test_the_residual_is_how_far_the_projector_sees_the_point_from_its_phase(
    stored: StoredResult,
) -> None:
    residual = residual_px(stored)
    assert residual is not None
    assert residual[PIXEL] == pytest.approx(0, abs=1e-3)  # points are kept in single precision
    assert np.isnan(residual[stored.rejection != 0]).all()
    late = stored.maps["absolute_phase"] - 2 * np.pi * 0.25 / PERIOD_PX
    moved = residual_px(replace(stored, maps=stored.maps | {"absolute_phase": late}))
    assert moved is not None
    assert moved[PIXEL] - residual[PIXEL] == pytest.approx(0.25, abs=1e-5)


def test_the_deviation_from_a_reference_is_positive_in_front_of_it(
    stored: StoredResult, tmp_path: Path
) -> None:
    """The reference is the result, moved away from C1 by 0.5 mm: nearly square to it but at the
    bump in the middle.
    """
    moved = stored.maps["points_mm"][stored.rejection == 0] + [0, 0, 0.5]
    np.save(tmp_path / "moved.npy", moved)
    found = compared_with(tmp_path / "moved.npy", stored).maps["deviation_mm"]
    assert np.isnan(found[stored.rejection != 0]).all()
    assert np.nanmedian(found[:, :15]) == pytest.approx(0.5, abs=0.02)


def test_a_light_sheet_has_one_coordinate(stored: StoredResult) -> None:
    """Of a projector with a distorting lens, as OpenCV projects it."""
    assert stored.rig is not None
    projector = stored.rig.devices[2]
    for angle in (0.0, np.pi / 2, 0.3):
        vertices, faces = light_sheet(projector, 30.0, angle, 400.0)
        np.testing.assert_allclose(vertices[0], projector.center_world)
        assert len(faces) == len(vertices) - 2
        for tip in vertices[1:]:
            u, v = seen_by_opencv(projector, tip)
            assert np.cos(angle) * (u + 0.5) + np.sin(angle) * (v + 0.5) == pytest.approx(
                30, abs=1e-4
            )


def test_surfaces_end_at_steps_and_holes() -> None:
    y, x = np.mgrid[:6, :8].astype(float)
    points = np.stack([x, y, 100.0 * (x > 3)], axis=-1)
    points[2, 1] = np.nan
    faces = grid_triangles(points)
    assert len(faces) == 2 * 5 * (3 + 3) - 6  # six triangles meet at the hole
    assert not (faces == 2 * 8 + 1).any()
    left = faces % 8 <= 3
    assert (left.all(axis=1) | ~left.any(axis=1)).all()


def test_a_rejected_pixel_says_why(stored: StoredResult) -> None:
    story = pixel_story(stored, 0, 0)
    assert story.candidates == ()
    assert "too little fringe contrast" in story.words


def test_a_pixel_outside_is_refused(stored: StoredResult) -> None:
    with pytest.raises(MethodError, match="row 0 to 59"):
        pixel_story(stored, 60, 0)


def test_a_line_of_sight_finds_its_point() -> None:
    points = np.full((2, 3, 3), np.nan)
    points[1, 2], points[0, 1] = [1, 0, 10], [0, 0, -10]
    assert nearest_pixel(points, [0, 0, 0], [0.1, 0, 1]) == (1, 2)
    assert nearest_pixel(np.full((2, 2, 3), np.nan), [0, 0, 0], [0, 0, 1]) is None


def test_directions_are_read_as_they_are_named() -> None:
    from fringe3d.health import axis_name

    for angle in (0.0, np.pi / 2, 0.4):
        assert angle_of(axis_name(angle)) == pytest.approx(angle, abs=1e-5)


def test_edges_of_a_volume_and_of_a_view() -> None:
    box = volume_lines(MeasuringVolume.box([0, 0, 0], [1, 2, 3]))
    lengths = np.sort(np.linalg.norm(box[:, 0] - box[:, 1], axis=1))
    np.testing.assert_allclose(lengths, np.repeat([1, 2, 3], 4), atol=1e-9)
    slab = MeasuringVolume(normals=[[0, 0, 1], [0, 0, -1]], offsets_mm=[1, 0])
    assert len(volume_lines(slab)) == 0
    assert frustum_lines(device("c1", "camera", 0, 0), 50.0).shape == (8, 2, 3)


def test_a_page_of_the_points_alone(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "cloud.html"
    main(["view", str(folder), "--html", str(page), "--points", "500"])
    text = page.read_text(encoding="utf-8")
    assert "500 of 4,360 points" in text
    assert "http" not in text.replace("http-equiv", "")


def test_what_to_install_is_said(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fringe3d.view.live", None)
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(SystemExit):
        main(["view", str(folder)])
    assert "fringe3d[view]" in capsys.readouterr().err


def test_a_browser_shows_the_live_view(stored: StoredResult) -> None:
    pytest.importorskip("viser")
    from fringe3d.view.live import LiveView

    with browser() as chromium:
        live = LiveView(stored, host="127.0.0.1", port=8765)
        try:
            assert "127.0.0.1" in live.address
            page, said = watched_page(chromium)
            page.goto(live.address)
            page.wait_for_selector(CANVAS, timeout=60_000)
            by_depth = settled(page)
            live.colour_by("brightness")
            assert (settled(page, unlike=by_depth) != by_depth).any(axis=-1).mean() > 0.01
            live.show_pixel(*PIXEL)
            page.get_by_text("row 31, column 42").wait_for(timeout=20_000)
            page.mouse.click(250, 350)
            page.get_by_text("row 31, column 42:").wait_for(state="hidden", timeout=20_000)
            assert "order" in live.story.content
            before = pixels_of(page.locator(CANVAS).first)
            live.as_surface(True)
            assert (settled(page, unlike=before) != before).any(axis=-1).mean() > 0.01
            assert said == []
        finally:
            live.server.stop()


def test_points_move_as_the_browser_can_draw_them() -> None:
    """Browsers of two speeds, told by their frames alone: the level is the fastest that fits."""
    levels = levels_of(1_000_000)

    def driven(frame_s: Callable[[int], float], frames: int) -> tuple[Detail, float]:
        detail, now = Detail(levels), 100.0
        for _ in range(frames):
            detail.moved(now)
            now += frame_s(levels[detail.level])
        return detail, now

    # 40 ms for the page and 2 us a point: 16,384 points take 73 ms, 32,768 more than 75.
    slow, now = driven(lambda n: 0.04 + 2e-6 * n, 100)
    assert levels[slow.level] == 16_384
    assert levels[slow.resting] < 1_000_000
    fast, _ = driven(lambda _: 0.02, 100)
    assert levels[fast.level] == levels[fast.resting] == 1_000_000
    # After a rest the slow one sees more, step by step, and fewer at once when it moves again.
    waits = [slow.wait_s(now)]
    assert 0.3 < waits[0] < 0.5
    shown = [slow.level]
    while slow.level < slow.resting:
        slow.rested(now)
        shown.append(slow.level)
    assert shown == sorted(shown)
    assert levels[shown[-1]] == 262_144  # 0.57 s
    slow.moved(now)
    assert levels[slow.level] == 16_384
    slow.is_everything = True
    assert levels[slow.resting] == 1_000_000


def test_a_pause_of_the_hand_is_no_slow_frame() -> None:
    detail = Detail(levels_of(100_000))
    for frame in range(40):
        detail.moved(0.02 * frame + 2.0 * (frame // 4))
    assert detail.level == detail.resting == len(levels_of(100_000)) - 1


def test_some_of_the_points_cover_the_same_area(
    stored: StoredResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two results of 4,360 points: 1,000 of all, as many of each, evenly spread."""
    pytest.importorskip("viser")
    from fringe3d.view import live as module

    monkeypatch.setattr(module, "levels_of", lambda n: [1000, n])
    live = module.LiveView([stored, stored], host="127.0.0.1", port=8767,
                           phases=lambda _: {})  # fmt: skip
    try:
        few, others = live.cloud.nodes
        size = few.point_size
        live.show_level(0)
        assert (few.visible, others.visible) == (True, False)
        assert len(few.points) == len(few.colors) == 500
        assert few.point_size == pytest.approx(size * np.sqrt(8.72))
        middle = live._staged(stored, np.zeros(3))[stored.rejection.ravel() == 0].mean(axis=0)
        # Of 500 points over 20 by 15 mm; at random the mean is within 3 x 0.26 mm.
        np.testing.assert_allclose(few.points.mean(axis=0)[:2], middle[:2], atol=0.8)
        live.colour_by("brightness")
        assert (len(few.colors), len(others.colors)) == (500, 3860)
        live.show_level(1)
        assert (few.visible, others.visible) == (True, True)
        assert few.point_size == pytest.approx(size)
    finally:
        live.server.stop()


def test_a_browser_shows_results_side_by_side(stored: StoredResult) -> None:
    pytest.importorskip("viser")
    from fringe3d.view.live import LiveView

    farther = dict(stored.maps)
    farther["points_mm"] = stored.maps["points_mm"] + [0, 0, 2.0]
    second = replace(stored, folder=Path("second"), maps=farther)
    with browser() as chromium:
        live = LiveView([stored, second], host="127.0.0.1", port=8766,
                        phases=lambda _: {"c2": seen_phases("c2", 0.3, stored)})  # fmt: skip
        try:
            page, said = watched_page(chromium)
            page.goto(live.address)
            page.wait_for_selector(CANVAS, timeout=60_000)
            settled(page)
            live.colour_by("from the first")
            assert "mm" in live.scale.content
            live.sheets.value = True
            story = live.show_pixel(*PIXEL, number=1)
            assert story is not None
            assert "misses c2's phase by +0.048 periods" in live.story.content
            page.get_by_text("misses c2's phase").first.wait_for(timeout=60_000)
            assert said == []
        finally:
            live.server.stop()


def settled(page: Any, *, unlike: Any = None, patience_s: float = 40.0) -> np.ndarray:
    """Return what the canvas shows once it shows much (and something else than before)."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        shown = pixels_of(page.locator(CANVAS).first)
        coloured = np.ptp(shown.astype(int), axis=-1) > 40
        is_new = unlike is None or (shown != unlike).any(axis=-1).mean() > 0.01
        if is_new and (unlike is not None or coloured.mean() > 0.02):
            return shown
        page.wait_for_timeout(300)
    raise AssertionError("the canvas never showed the points")
