"""Reports of designs, calibrations and acceptance as pages, and pages as PDF."""

from __future__ import annotations

import base64
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fringe3d.cli import main
from fringe3d.io.results import write_coloured_ply
from fringe3d.io.rigfile import rig_text
from fringe3d.model.html import png
from fringe3d.report.written import IN_FOLDERS, written_html, written_report
from fringe3d.simulate import PRESETS
from stored_result import write_stored_result

TEXT = """# A <b>design</b>

See [elsewhere](http://somewhere.invalid/) and ![maps](maps.png), not ![this](/etc/passwd.png).

| what | value |
|---|---|
| form | 3 um |

    fringe3d design rig.toml

<script>alert(1)</script>
"""


@pytest.fixture
def design(tmp_path: Path) -> Path:
    import numpy as np

    folder = tmp_path / "design"
    folder.mkdir()
    (folder / "design.md").write_text(TEXT, encoding="utf-8")
    (folder / "maps.png").write_bytes(png(np.zeros((2, 3, 3), np.uint8)))
    return folder


def test_a_written_report_becomes_a_page_that_links_to_nothing(design: Path) -> None:
    main(["report", str(design)])
    page = (design / "report.html").read_text(encoding="utf-8")
    assert "<td>3 um</td>" in page
    assert "<title>A &lt;b&gt;design&lt;/b&gt;</title>" in page
    assert "<script>alert" not in page
    assert re.findall(r'(?:src|href)="(?!data:)', page) == []
    assert "http:" not in page
    data = base64.b64encode((design / "maps.png").read_bytes()).decode()
    assert data in page


@pytest.mark.parametrize("name", IN_FOLDERS)
def test_reports_are_found_in_their_folders(tmp_path: Path, name: str) -> None:
    assert written_report(tmp_path) is None
    (tmp_path / name).write_text("# x", encoding="utf-8")
    assert written_report(tmp_path) == tmp_path / name


def test_a_calibration_is_reported_beside_its_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text("", encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["report", str(rig)])
    assert "rig-board.md" in " ".join(capsys.readouterr().err.split())
    (tmp_path / "rig-board.md").write_text("# Calibration of a rig", encoding="utf-8")
    main(["report", str(rig)])
    assert "Calibration of a rig" in (tmp_path / "rig-report.html").read_text(encoding="utf-8")
    assert rig.read_text(encoding="utf-8") == ""


def test_a_report_does_not_replace_what_it_reports(design: Path) -> None:
    with pytest.raises(SystemExit):
        main(["report", str(design), "--out", str(design / "design.md"), "--overwrite"])
    assert (design / "design.md").read_text(encoding="utf-8") == TEXT


def test_what_prints_is_said_where_no_browser_is(
    design: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    with pytest.raises(SystemExit):
        main(["report", str(design), "--pdf"])
    assert "expected a browser that prints" in capsys.readouterr().err
    assert sorted(path.name for path in design.iterdir()) == ["design.md", "maps.png"]


def test_a_result_is_printed(tmp_path: Path) -> None:
    if shutil.which("chromium") is None:
        pytest.skip("no chromium; on Debian: apt-get install chromium")
    result = write_stored_result(tmp_path / "result")
    main(["report", str(result), "--pdf"])
    content = (result / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert content.rstrip().endswith(b"%%EOF")
    assert len(content) > 50_000  # the pictures are in it


def shown_in(page: str) -> dict[str, Any]:
    """Return what the page hands to its 3D view."""
    found = re.search(r'showCloud\(document.getElementById\("cloud"\), (.*)\);', page)
    assert found is not None
    shown: dict[str, Any] = json.loads(found[1])
    return shown


def test_deviations_are_shown_in_three_dimensions(tmp_path: Path) -> None:
    """From where they were seen: what is nearer to the viewpoint is nearer to the eye."""
    rng = np.random.default_rng(3)
    points = rng.uniform([0, 0, 0], [30, 20, 5], (500, 3))
    (tmp_path / "compare.md").write_text("# x", encoding="utf-8")
    signed = np.where(points[:, 0] < 15, 0.02, -0.01)
    signed[:50] = np.nan
    colours = np.zeros((500, 3), np.uint8)
    write_coloured_ply(tmp_path / "deviations.ply", points, colours,
                       viewpoint_mm=np.array([15.0, 10.0, 300.0]), deviation_mm=signed)  # fmt: skip
    shown = shown_in(written_html(tmp_path / "compare.md"))
    assert (shown["count"], shown["of"]) == (500, 500)
    assert [channel["name"] for channel in shown["channels"]] == ["deviation", "depth z"]
    assert (shown["channels"][0]["low"], shown["channels"][0]["high"]) == pytest.approx(
        (-20.0, 20.0)
    )
    right, down, ahead = np.array(shown["rotation"])
    assert ahead @ [0, 0, -1] > 0.99
    assert np.cross(right, down) == pytest.approx(ahead)
    np.testing.assert_allclose(shown["size_mm"], np.ptp(points, axis=0), rtol=1e-6)


def test_a_rig_is_shown_in_three_dimensions(tmp_path: Path) -> None:
    """All corners of its volume and all centres of its devices lie in the box that is shown."""
    rig = PRESETS["kolibri"]((64, 48)).rig
    (tmp_path / "own.toml").write_text(rig_text(rig), encoding="utf-8")
    (tmp_path / "own-board.md").write_text("# x", encoding="utf-8")
    shown = shown_in(written_html(tmp_path / "own-board.md"))
    low = np.array(shown["low_mm"])
    high = low + shown["size_mm"]
    for device in rig.devices:
        assert (device.center_world > low - 1e-3).all()
        assert (device.center_world < high + 1e-3).all()
    assert high[2] == pytest.approx(max(d.center_world[2] for d in rig.devices), abs=1e-3)
    (channel,) = shown["channels"]
    assert (channel["low"], channel["high"]) == ("camera", "projector")
    kinds = np.frombuffer(base64.b64decode(channel["values"]), np.uint8)
    assert set(kinds) == {0, 128, 255}
