"""``fringe3d design``: what it prints and writes, and what it says to mistakes."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fringe3d.cli import main
from fringe3d.cli.console import Reporter
from fringe3d.cli.designer import DesignOptions, run_design
from fringe3d.cli.optimiser import Optimised
from fringe3d.design import Assessment, assess, fringe_crossing
from fringe3d.errors import Fringe3DError
from fringe3d.io.rigfile import rig_text
from fringe3d.io.sketchfile import read_sketch
from fringe3d.model import MeasuringVolume, Rig
from fringe3d.report.design import WIDTH, markdown, summary
from fringe3d.report.design_record import record
from fringe3d.report.design_words import findings, percent, recommendation

pytestmark = pytest.mark.usefixtures("one_thread")

EXAMPLE = Path(__file__).parent.parent / "examples" / "sketches" / "kolibri.toml"


@pytest.fixture(scope="module", autouse=True)
def coarse_grids() -> Iterator[None]:
    """Count on coarser grids than a user gets."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fringe3d.design.assessment.COARSE_PIXELS", 500)
        patch.setattr("fringe3d.design.assessment.MARGIN_PIXELS", 60)
        yield


@pytest.fixture(scope="module")
def sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the source paper's rig with cameras of 80 x 64 px."""
    path = tmp_path_factory.mktemp("design") / "small.toml"
    text = EXAMPLE.read_text(encoding="utf-8")
    path.write_text(text.replace("size = [640, 512]", "size = [80, 64]"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def rig(sketch: Path) -> Rig:
    return read_sketch(sketch).rig


@pytest.fixture(scope="module")
def assessed(rig: Rig) -> Assessment:
    return assess(rig, period_px=16.0)


def run(rig: object, **options: Any) -> tuple[str, dict[str, Any]]:
    return run_design(DesignOptions(rig=str(rig), **options), Reporter(quiet=True))


def test_the_assessment_gives_the_papers_figures(assessed: Assessment) -> None:
    assert math.degrees(assessed.angle_c1c2) == pytest.approx(27.04, abs=0.01)
    # cos 13.61 deg = sin 27 deg sin 22 deg cos 31 deg + cos 27 deg cos 22 deg = 0.971908
    assert math.degrees(assessed.angle_c1p) == pytest.approx(13.614, abs=0.001)
    assert assessed.projector_needs is not None
    assert 4.1 < assessed.projector_needs.max_periods < 4.2
    assert assessed.projector_needs.bits == 2
    assert assessed.camera_needs is not None
    assert assessed.camera_needs.bits == 3  # the projector's geometry saves one
    assert assessed.place is not None
    assert 3.1 < math.degrees(assessed.place.free_angle) < 3.3
    assert [equation.number for equation in assessed.equations] == [1, 2, 3, 4, 5]
    first = assessed.equations[0]
    assert first.printed < 0 < first.exact
    assert "does not hold: -3.3 times the nominal period" in first.remark
    assert assessed.equations[1].remark == "holds for parallel axes; 12.3 % too long at 27.0 deg"
    assert assessed.margins is not None
    assert assessed.margins.worst_margin[0] < 0.03  # C2 tells no wrong order on the middle


def test_equations_follow_from_the_rigs_own_figures(assessed: Assessment) -> None:
    # Depths 335 -+ 12.5 / cos 27 deg = 320.971 and 349.029; focal 80 * 335 / 93 = 288.172 px.
    # (1) 16 * 288.172 / 3215 = 1.434134; tan 13.614 deg * 288.172 * 28.058 / 320.971 = 6.1009
    # (2) 14.029 / 320.971 + 14.029 / 349.029 = 0.083902; tan 27.0395 deg = 0.510503
    printed = [equation.printed for equation in assessed.equations]
    assert printed[0] == pytest.approx(1.4341 - 6.1009, abs=5e-4)
    assert printed[1] == pytest.approx(288.172 * 0.083902 * 0.510503, abs=5e-4)
    assert math.isnan(printed[2])
    assert math.isnan(printed[3])
    # (5) 16 / 3215 / 0.083902 = 0.059315; atan = 3.3945 deg
    assert math.degrees(printed[4]) == pytest.approx(3.3945, abs=1e-3)


def test_the_summary_fits_a_terminal(assessed: Assessment) -> None:
    lines = summary(assessed, name="small").splitlines()
    assert max(map(len, lines)) <= WIDTH
    text = "\n".join(lines)
    for part in (
        r"\(1\) shortest period in C2, px +-4\.67",
        r"\(3\) periods on a segment +- +3\.9\d +4\.1\d",
        r"with the projector's geometry +4\.1\d +5 +2 / 3 +3 / 4",
        r"with C2's segment alone +8\.2\d +9 +3 / 4 +4 / 5",
        r"median 4\.[78] um",
    ):
        assert re.search(part, text), part


def test_the_recommendation_stands_first(assessed: Assessment) -> None:
    said = recommendation(assessed)
    assert said[0].startswith(
        "7 images: 4 phase steps and a reduced Gray code of 2 bits (3 images, over-determined); "
    )
    text = "\n".join(said)
    assert "up to 40 % of a segment beyond the volume, take 3 bits: 8 images." in text
    assert "Fringes alone (4 images) do not suffice pixel by pixel" in text
    assert "M6, which decides by all pixels together, does with the same images where" in text
    assert "saves 1 image" in "\n".join(findings(assessed))
    lines = summary(assessed, name="small").splitlines()
    assert lines[0].startswith("small: 7 images: 4 phase steps and a reduced Gray code")
    options = "--size 1024x768 --period 16 --steps 4 --gray-bits 2 --out patterns"
    assert f"  fringe3d patterns {options}" in lines[:12]
    report = markdown(assessed, name="small", command="", pictures=(), advice="Four do.")
    assert report.startswith(f"# Design of small\n\n**{said[0]}**\n\n- Where a table")
    assert report.index("- With the projector elsewhere: Four do.") < report.index("##")


def test_the_images_to_project_are_as_many_as_recommended(
    rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, a in enumerate(
        (
            assess(rig, period_px=16.0),
            assess(rig, period_px=80.0),
            assess(rig, period_px=16.0, angle=0.3),
            assess(rig, period_px=16.0, beyond=0.4),
            assess(rig, period_px=250.0, beyond=0.4),
        )
    ):
        command = record(a, name="x", command="")["patterns_command"].split()
        assert command[0] == "fringe3d"
        main([*command[1:-1], str(tmp_path / str(number))])
        told = capsys.readouterr().out
        assert told.startswith(f"{record(a, name='x', command='')['images']} images of 1024 x 768")


def test_the_columns_of_the_equations_are_explained(assessed: Assessment) -> None:
    text = " ".join(summary(assessed, name="small").split())
    assert "exact: its closed form on C1's principal ray, for fringes square to" in text
    assert "all pixels: the worst pixel of the rig as it is, in (5) with a guard" in text
    # One figure for the principal ray, 3.40, that of the table.
    assert "3.42" not in text
    assert "principal_ray" not in json.dumps(record(assessed, name="x", command=""))


def test_surfaces_beyond_the_volume_are_counted_if_asked(rig: Rig, sketch: Path) -> None:
    """Everything follows: the code, the angle without one, the record."""
    plain, wide = assess(rig, period_px=16.0), assess(rig, period_px=16.0, beyond=0.4)
    assert (plain.bits, wide.bits) == (2, 3)
    assert wide.needs.twins_beyond == plain.needs.twins_beyond  # 0.4 is what both count with
    said = recommendation(wide)
    assert said[0] == (
        "8 images: 4 phase steps and a reduced Gray code of 3 bits (4 images, over-determined)."
    )
    assert said[1].startswith("Surfaces up to 40 % of a segment beyond the volume, such as a table")
    assert plain.place is not None
    assert wide.place is not None
    # Segments that hold 1.4 times the periods leave 1 / 1.4 of the angle, but for perspective.
    assert wide.place.free_angle / plain.place.free_angle == pytest.approx(1 / 1.4, rel=0.05)
    _, found = run(sketch, beyond=0.4)
    assert (found["beyond"], found["images"]) == (0.4, 8)
    assert assess(rig, period_px=16.0, beyond=0.0).bits == 2


def test_the_command_hands_beyond_on(sketch: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["design", str(sketch), "--beyond", "0.4", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert (found["beyond"], found["images"], found["optimised"]) == (0.4, 8, None)
    with pytest.raises(SystemExit):
        main(["design", str(sketch), "--beyond", "-0.1"])
    assert "at least 0" in capsys.readouterr().err


def test_what_the_optimiser_advises_stands_with_the_recommendation(
    sketch: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    def optimised(_rig: Rig, **options: Any) -> Optimised:
        asked.update(options)
        return Optimised(advice="four do.", text="0 given", record={"recommended": None})

    monkeypatch.setattr("fringe3d.cli.optimiser.run_optimise", optimised)
    text, found = run(sketch, optimise=True, beyond=0.3, out=tmp_path / "out")
    assert asked["beyond"] == 0.3
    lines = text.splitlines()
    assert lines.index("- With the projector elsewhere: four do.") < lines.index("")
    assert "0 given" in lines
    assert found["optimised"] == {"recommended": None}
    report = (tmp_path / "out" / "design.md").read_text(encoding="utf-8")
    assert "## With the projector elsewhere\n\n```\n0 given\n```" in report


def test_the_last_row_and_column_are_counted(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a coarse grid, too, the longest segment is found to lie in a corner of the image."""
    camera = rig.cameras[0]
    small = replace(camera, n_rows=40, n_cols=50, center_px=camera.center_px - [15.0, 12.0])
    flat = replace(rig, cameras=(small, *rig.cameras[1:]),
                   volume=MeasuringVolume.box([-80, -80, -2], [80, 80, 2]))  # fmt: skip
    whole = assess(flat, period_px=16.0)
    monkeypatch.setattr("fringe3d.design.assessment.MAX_PIXELS", 40)
    coarse = assess(flat, period_px=16.0)
    assert (whole.step, coarse.step) == (1, 8)
    assert coarse.needs.max_periods == whole.needs.max_periods
    assert coarse.camera_needs is not None
    assert whole.camera_needs is not None
    assert coarse.camera_needs.max_periods == whole.camera_needs.max_periods


def test_a_segment_below_a_period_needs_no_code(rig: Rig) -> None:
    wide = assess(rig, period_px=80.0)
    assert recommendation(wide)[:2] == [
        "4 images: 4 phase steps and no Gray code, for every segment is shorter than a period "
        "(M5).",
        "Where a table or a wall is seen up to 40 % of a segment beyond the volume, take 1 bit: 6 "
        "images.",
    ]


def test_fringes_along_the_epipolar_lines_are_told(rig: Rig) -> None:
    assert rig.projector is not None
    for angle_deg in (0.0, 40.0, 90.0):
        crossing, square = fringe_crossing(
            rig, np.zeros(3), period_px=16.0, angle=math.radians(angle_deg)
        )
        assert math.degrees(crossing) == pytest.approx(90.0 - angle_deg, abs=1e-4)
        assert math.degrees(square) == pytest.approx(0.0, abs=1e-4)
    flat = assess(rig, period_px=16.0, angle=math.radians(89.0))
    assert "nearly follow the epipolar lines (1 deg between them)" in recommendation(flat)[0]
    assert "Turn them to 0 deg" in recommendation(flat)[0]


def test_other_rigs_get_what_they_allow(rig: Rig) -> None:
    single = assess(replace(rig, cameras=rig.cameras[:1]), period_px=16.0)
    assert [equation.number for equation in single.equations] == [3, 4, 5]
    assert (single.camera_needs, single.margins) == (None, None)
    stereo = assess(replace(rig, projector=None), period_px=16.0, camera_period_px=1.4)
    assert [equation.number for equation in stereo.equations] == [2, 3, 4]
    assert (stereo.projector_needs, stereo.place) == (None, None)
    assert stereo.camera_needs is not None
    # Segments of up to 11.8 px hold 8.4 periods of 1.4 px.
    assert stereo.camera_needs.max_periods == pytest.approx(8.4, abs=0.1)
    for found in (single, stereo):
        assert max(map(len, summary(found, name="x").splitlines())) <= WIDTH
        json.dumps(record(found, name="x", command=""), allow_nan=False)


@pytest.mark.parametrize(
    ("share", "text"), [(0.0, "0 %"), (0.0004, "below 0.1 %"), (0.0073, "0.7 %"), (1.0, "100.0 %")]
)
def test_small_shares_are_not_called_none(share: float, text: str) -> None:
    assert percent(share) == text


def test_the_folder_holds_report_record_and_pictures(sketch: Path, tmp_path: Path) -> None:
    out = tmp_path / "design"
    text, found = run(sketch, out=out)
    assert text.endswith(f"-> {out}")
    assert sorted(path.name for path in out.iterdir()) == [
        "design.json", "design.md", "maps.png", "rig.png", "rig.toml", "segments.png"
    ]  # fmt: skip
    written = json.loads((out / "design.json").read_text(encoding="utf-8"))
    assert written == {key: value for key, value in found.items() if key != "out"}
    assert written["gray_code"]["projector_segment"]["bits"] == 2
    assert written["equations"][2]["printed"] is None
    report = (out / "design.md").read_text(encoding="utf-8")
    for name in ("rig.png", "maps.png", "segments.png"):
        assert f"]({name})" in report
        picture = cv2.imread(str(out / name))
        assert picture is not None
        assert min(picture.shape[:2]) > 400
        # Not an empty page: the ink differs from the background on a good part of it.
        assert (np.ptp(picture.astype(int), axis=2) > 20).mean() > 0.005
    assert str(tmp_path) not in report.replace(f"`{found['command']}`", "")
    tables = [line for line in report.splitlines() if line.startswith("|")]
    assert len(tables) > 12


def test_options_override_the_sketch(sketch: Path) -> None:
    text, found = run(sketch, period_px=32.0, steps=8, angle_deg=10.0, depth_mm=(330.0, 340.0),
                      noise=0.02, calibration_px=0.3)  # fmt: skip
    assert (found["period_px"], found["steps"]) == (32.0, 8)
    assert found["fringe_angle_deg"] == pytest.approx(10.0)
    assert (found["depth_min_mm"], found["depth_max_mm"]) == pytest.approx((330.0, 340.0))
    # 3 sqrt(2/8) 0.02 / 2 pi + 0.3 / 32 = 0.0047746 + 0.009375
    assert found["guard_periods"] == pytest.approx(0.0141496, abs=1e-6)
    assert "period 32 px, fringes at 10 deg, 8 steps" in " ".join(text.split())


def test_a_rig_file_and_a_preset_are_designs_too(rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(rig_text(replace(rig, volume=None)), encoding="utf-8")
    with pytest.raises(Fringe3DError, match=r"expected a measuring volume.*--depth MIN:MAX"):
        run(path)
    _, found = run(path, depth_mm=(320.0, 350.0))
    assert found["period_px"] == 16.0
    # The whole of C1's view between 320 and 350 mm: (5) is 3.1745 deg there.
    assert found["equations"][4]["printed_deg"] == pytest.approx(3.1745, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rig": "kolibry"}, r"found 'kolibry'. Did you mean 'kolibri'\?"),
        ({"rig": "nothing.toml"}, "nothing.toml: expected a file, found none"),
        ({"noise": -1.0}, "noise"),
        ({"steps": 2}, "n_shifts"),
        ({"depth_mm": (900.0, 950.0)}, "rig: expected"),
    ],
)
def test_mistakes_get_one_message(sketch: Path, options: dict[str, Any], message: str) -> None:
    pytest.importorskip("embreex")
    with pytest.raises(Fringe3DError, match=message):
        run(options.pop("rig", sketch), **options)


def test_an_existing_folder_is_kept(sketch: Path, tmp_path: Path) -> None:
    keep = tmp_path / "keep"
    keep.mkdir()
    (keep / "mine.txt").write_text("mine")
    with pytest.raises(Fringe3DError, match="does not exist yet"):
        run(sketch, out=keep)
    with pytest.raises(Fringe3DError, match="apart from the input"):
        run(sketch, out=sketch.parent, overwrite=True)
    assert (keep / "mine.txt").read_text() == "mine"
