"""``fringe3d calibrate bias``, as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from fringe3d.cli.run import main
from fringe3d.io.rigfile import read_rig

pytest.importorskip("embreex")


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bias") / "scan"
    main(["simulate", "kolibri", "--object", "two-bodies", "--plan", "m2", "--camera-size",
          "320x256", "--out", str(out)])  # fmt: skip
    return out


def test_bias_is_stored_with_the_rig(
    scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rig is the true one: what is learnt is noise, well below a tenth of a pixel."""
    out = tmp_path / "rig.toml"
    main(["calibrate", "bias", "--from", str(scan), "--out", str(out), "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["bias_px"] < 0.1
    assert told["certainty"] > 0.99
    bias = read_rig(out).bias
    assert bias is not None
    assert bias.rms_px == pytest.approx(told["bias_px"])
    assert bias.source == "scan"
    picture = cv2.imread(str(tmp_path / "rig-bias.png"))
    assert picture is not None
    assert picture.std() > 10  # there is something to be seen
    main(["measure", str(scan), "--rig", str(out), "--out", str(tmp_path / "result"), "--json"])
    health = json.loads(capsys.readouterr().out)["health"]
    assert any("stored with the rig" in finding["text"] for finding in health)


def test_mistakes_are_told_and_nothing_is_written(
    scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rig.toml"
    out.write_text("mine")
    with pytest.raises(SystemExit):
        main(["calibrate", "bias", "--from", str(scan), "--out", str(out)])
    assert "--overwrite" in capsys.readouterr().err
    assert out.read_text() == "mine"
    with pytest.raises(SystemExit):
        main(["calibrate", "bias", "--from", str(scan), "--images", "a", "--images", "b",
              "--out", str(tmp_path / "new.toml")])  # fmt: skip
    assert "--images: expected one folder for all scans or one for each" in capsys.readouterr().err
    assert not (tmp_path / "new.toml").exists()
