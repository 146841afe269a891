"""The report of a measurement: what it says, and what a browser shows of it."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest

from browser import browser, pixels_of, watched_page
from fringe3d.cli import main
from fringe3d.io.stored import read_result
from fringe3d.report.advice import ADVICE, reason_rows
from fringe3d.report.cloud_data import packed_cloud
from stored_result import N_DARK, N_SATURATED, SHAPE, write_stored_result

BACKGROUND = (16, 18, 22)
GREY_SPREAD = 8
N_POINTS = 4360
"""Borders of points mix with the background, which is a little blue."""


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_stored_result(tmp_path_factory.mktemp("report") / "result")
    main(["report", str(folder)])
    return folder


@pytest.fixture(scope="module")
def text(result: Path) -> str:
    return (result / "report.html").read_text(encoding="utf-8")


def test_the_page_is_whole_and_links_to_nothing(text: str) -> None:
    assert text.rstrip().endswith("</html>")
    assert len(text) < 5e6
    assert re.findall(r'(?:src|href)="(?!data:)', text) == []
    assert "http:" not in text
    assert "https:" not in text


def test_words_of_the_user_are_no_markup(text: str) -> None:
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert" in text
    assert "<b>fits" not in text
    assert "fringe3d measure &#39;a&amp;b&#39; --out &lt;here&gt;" in text


def test_figures_are_those_of_the_maps(text: str) -> None:
    n_points = SHAPE[0] * SHAPE[1] - N_DARK - N_SATURATED
    assert f"{n_points:,} of 4,800 pixels ({n_points / 4800:.1%})" in text
    assert "-10.00 to 9.75 mm" in text  # x: columns 0 to 79, a quarter of a mm apart
    assert "92.00 to 100.00 mm" in text
    assert "distance of the two rays</th><td>median 4.0 um" in text


def test_each_pixel_counts_under_its_first_reason(result: Path) -> None:
    rows = reason_rows(read_result(result).rejection)
    assert [(row.name, row.n_pixels) for row in rows] == [
        ("low modulation", N_DARK),
        ("saturated", N_SATURATED),
    ]


def test_advice_comes_from_warnings_and_frequent_reasons(text: str) -> None:
    advice = text[text.index("What to do better") : text.index("<h2>Pictures")]
    assert "gamma; expose anew" in advice
    assert "expose longer, darken the room" in advice
    assert "Expose shorter" not in advice  # less than 2 % of the pixels
    assert "all is well" not in advice


def test_every_reason_has_its_advice() -> None:
    from fringe3d.model import Rejection

    assert set(ADVICE) == set(Rejection)


def test_a_large_cloud_is_thinned_and_says_so(result: Path) -> None:
    cloud = packed_cloud(read_result(result).maps, None, most=1000)
    assert (cloud["count"], cloud["of"]) == (1000, 4800 - N_DARK - N_SATURATED)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "measure.toml").unlink(), "found no measure.toml"),
        (lambda folder: (folder / "measure.toml").write_text(""), "measure.toml: expected summary"),
        (lambda folder: (folder / "points.npz").write_bytes(b"x"), "damaged"),
        (lambda folder: (folder / "points.npz").rename(folder / "phase.npz"), "phases alone"),
    ],
)
def test_what_is_no_result_is_refused(
    spoil: object, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_stored_result(tmp_path / "result")
    assert callable(spoil)
    spoil(folder)
    with pytest.raises(SystemExit) as stopped:
        main(["report", str(folder)])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err
    assert not (folder / "report.html").exists()


def test_a_report_is_not_overwritten_unasked(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["report", str(result)])
    assert "--overwrite" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["report", "--out"], ["view", "--html"]])
def test_a_page_does_not_replace_the_points(
    words: list[str], result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([words[0], str(result), words[1], str(result / "points.npz"), "--overwrite"])
    assert "apart from the input" in " ".join(capsys.readouterr().err.split())


def test_a_browser_shows_points_and_colours(result: Path) -> None:
    with browser() as chromium:
        page, said = watched_page(chromium)
        page.goto((result / "report.html").as_uri())
        page.wait_for_selector("#cloud[data-drawn]")
        canvas = page.locator("canvas")
        by_depth = pixels_of(canvas)
        is_point = (by_depth != BACKGROUND).any(axis=-1)
        assert 0.05 < is_point.mean() < 0.9
        page.select_option("select", label="brightness")
        grey = pixels_of(canvas)
        assert (np.ptp(grey[is_point].astype(int), axis=1) < GREY_SPREAD).mean() > 0.95
        assert (by_depth != grey).any(axis=-1)[is_point].mean() > 0.9
        box = canvas.bounding_box()
        page.mouse.move(box["x"] + 300, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 400, box["y"] + 200, steps=2)
        page.mouse.up()
        assert (pixels_of(canvas) != grey).any(axis=-1).mean() > 0.02
        assert page.evaluate("[...document.images].every(i => i.naturalWidth > 300)")
        # Each frame takes 200 ms: the coarsest level while it moves, all points at rest.
        page.wait_for_selector(f"#cloud[data-shown='{N_POINTS}']")
        page.evaluate(
            "() => { requestAnimationFrame = f => setTimeout(() => f(performance.now()), 200); }"
        )
        page.mouse.down()
        end = time.monotonic() + 20
        while page.get_attribute("#cloud", "data-shown") != "4096" and time.monotonic() < end:
            page.mouse.move(box["x"] + 300 + 50 * (time.monotonic() % 2), box["y"] + 200)
        assert page.get_attribute("#cloud", "data-shown") == "4096"
        page.mouse.up()
        page.wait_for_selector(f"#cloud[data-shown='{N_POINTS}']")
        assert said == []


def test_the_first_look_is_not_mirrored(result: Path) -> None:
    """Brightness rises with the column: to the right, as in the image."""
    with browser() as chromium:
        page, _ = watched_page(chromium)
        page.goto((result / "report.html").as_uri())
        page.wait_for_selector("#cloud[data-drawn]")
        page.select_option("select", label="brightness")
        grey = pixels_of(page.locator("canvas")).astype(float)
        is_point = (grey != BACKGROUND).any(axis=-1) & (grey < 250).any(axis=-1)
        columns = np.nonzero(is_point.sum(axis=0) > 20)[0]
        left, right = (np.median(grey[:, c, 0][is_point[:, c]]) for c in columns[[5, -5]])
        assert left + 50 < right
        rows = np.nonzero(is_point.sum(axis=1) > 20)[0]
        # The five dark rows are missing at the top, so the cloud's middle is as high as its box.
        assert abs(rows.mean() - grey.shape[0] / 2) < 0.1 * grey.shape[0]
