"""Nouns show themselves in a notebook, and pictures take one line."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from closed_form import Recording
from fringe3d import plot
from fringe3d.evaluate import fit_sphere
from fringe3d.io.stored import read_result
from fringe3d.model.html import MISSING, picture, png, table
from fringe3d.pipeline import Measurement, measure
from fringe3d.report.cloud_data import facing
from stored_result import write_stored_result


@pytest.fixture(scope="module")
def result(recording: Recording) -> Measurement:
    return measure(recording[0])


def shown(html: str) -> np.ndarray:
    """Return the first picture of a piece of HTML, as Pillow reads it."""
    found = re.search(r'src="data:image/png;base64,([^"]+)"', html)
    assert found
    with Image.open(io.BytesIO(base64.b64decode(found[1]))) as image:
        return np.asarray(image)


def test_a_png_is_read_back_by_pillow() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    with Image.open(io.BytesIO(png(pixels))) as image:
        np.testing.assert_array_equal(np.asarray(image), pixels)


def test_colours_run_from_the_least_to_the_greatest_value() -> None:
    values = np.array([[0.0, 1.0], [np.nan, 1.0]])
    grey = shown(picture(values, grey=True))
    assert grey[0, 0].tolist() == [0, 0, 0]
    assert grey[0, 1].tolist() == [255, 255, 255]
    assert tuple(grey[1, 0]) == MISSING
    assert shown(picture(np.zeros((2000, 10)))).shape[0] <= 320
    assert shown(picture(np.full((2, 2), np.nan))).shape == (2, 2, 3)


def test_words_are_no_markup() -> None:
    assert "<b>x" not in table("<b>x", [("<i>", "<script>")])


def test_nouns_show_themselves(recording: Recording, result: Measurement) -> None:
    scan = recording[0]
    html = scan._repr_html_()
    assert "plan of 11 images" in html
    assert "4 steps, period 16 px, 0 deg" in html
    assert scan.rig is not None
    for device in scan.rig.devices:
        assert f"<th>{device.name}</th>" in html
    html = result._repr_html_()
    assert result.points is not None
    assert f"{result.points.n_points:,} of 81,920 pixels" in html
    seen = (shown(html) != MISSING).any(axis=-1)
    np.testing.assert_array_equal(seen, result.points.is_valid)
    assert "the phase corrected the code" in result.findings[0]._repr_html_()


def test_phase_maps_show_themselves(result: Measurement) -> None:
    """As a picture of the projector's columns, dark where there is none."""
    main = result.main
    html = main._repr_html_()
    assert f"{(main.rejection == 0).sum():,} of 81,920" in html
    assert "fringe orders</th><td>64, each known" in html
    seen = (shown(html) != MISSING).any(axis=-1)
    np.testing.assert_array_equal(seen, main.rejection == 0)
    wrapped = result.phases[0].directions[0].wrapped[0]._repr_html_()
    assert "<th>steps</th><td>4</td>" in wrapped
    reduced = main.without_orders()._repr_html_()
    assert "64, told apart in 1 classes" in reduced


def test_a_fit_shows_its_numbers_with_units() -> None:
    """Of points on a sphere about (1, 2, 3) with a radius of 10 mm, one of them 0.1 mm outside."""
    way = np.random.default_rng(0).normal(size=(500, 3))
    points = np.array([1.0, 2, 3]) + 10 * way / np.linalg.norm(way, axis=1, keepdims=True)
    points[0] += 0.1 * way[0] / np.linalg.norm(way[0])
    html = fit_sphere(points, rejected_part=0.002)._repr_html_()
    assert "sphere through points" in html
    assert "center_mm</th><td>(1.0000, 2.0000, 3.0000) mm" in html
    assert "radius_mm</th><td>10.0000 mm" in html
    assert "499 used, 1 left out" in html


def test_a_stored_result_shows_itself(tmp_path: Path) -> None:
    html = read_result(write_stored_result(tmp_path / "r"))._repr_html_()
    assert "it &lt;b&gt;fits&lt;/b&gt;" in html
    assert "gamma; expose anew" in html


def test_every_picture_is_one_line(
    recording: Recording, result: Measurement, tmp_path: Path
) -> None:
    scan = recording[0]
    assert scan.rig is not None
    drawn = [
        plot.result(result), plot.depth(result), plot.sigma(result), plot.rejected(result),
        plot.phase(result.main), plot.images(scan.stacks[0]), plot.patterns(scan.stacks[0].plan),
        plot.rig(scan.rig),
    ]  # fmt: skip
    for number, made in enumerate(drawn):
        made.save(tmp_path / f"{number}.png")
        with Image.open(tmp_path / f"{number}.png") as image:
            assert np.asarray(image.convert("L")).std() > 10
    assert drawn[1]._repr_png_().startswith(b"\x89PNG")
    page = plot.cloud(result, most_points=500)
    assert "&lt;canvas&gt;" in page._repr_html_()
    page.save(tmp_path / "cloud.html")
    assert "500 of" in (tmp_path / "cloud.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("turn", [np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1])])
def test_the_side_from_which_points_were_seen_is_told(turn: Any) -> None:
    """Of a plane that faces the camera: rows of `turn` are the camera's axes in the world."""
    y, x = np.mgrid[:20, :30].astype(float)
    points = np.stack([x, y, 0 * x], axis=-1) @ turn
    points[3, 4] = np.nan
    np.testing.assert_allclose(facing(points), turn, atol=1e-9)
