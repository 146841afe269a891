"""What the report of ``merge --recalibrate`` says, and the rig that it leaves."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ball_views import camera
from fringe3d.calibrate import covariance_of, numbers_of
from fringe3d.io.rigfile import read_rig, rig_text
from fringe3d.model import Rig
from fringe3d.report.recalibration import (
    recalibration_lines,
    recalibration_record,
    recalibration_text,
)
from fringe3d.rig_from_views import RigChange, RigFromViews


def found(in_sigmas: float, contradiction: float = 0.7) -> RigFromViews:
    """Return a rig of two cameras whose second one turned by 0.02 deg about y."""
    rig = Rig(cameras=(camera(), replace(camera(), name="c2")))
    numbers = numbers_of(rig.cameras, 300.0)
    sigmas = np.array([0.1 * n.likely for n in numbers])
    changes = tuple(
        RigChange(device=("c1", "c2")[n.device], number=n.name, sigma=float(s), likely=n.likely,
                  value=math.radians(0.02) if n.name == "turn_y" else 0.0)
        for n, s in zip(numbers, sigmas, strict=True)
    )  # fmt: skip
    covariance = covariance_of(rig.cameras, numbers, np.diag(sigmas**2))
    return RigFromViews(
        rig=replace(rig, covariance=covariance), changes=changes, in_sigmas=in_sigmas,
        overlap_before_mm=0.02, overlap_mm=0.015, contradiction_before=8.0,
        contradiction=contradiction, form_mm=0.004, n_points=1000, n_rounds=4,
    )  # fmt: skip


def test_the_report_names_what_changed_with_units() -> None:
    record = recalibration_record(found(40.0))
    turn = next(c for c in record["changes"] if c["number"] == "turn_y")
    assert (turn["device"], turn["unit"]) == ("c2", "mdeg")
    assert turn["value"] == pytest.approx(20.0)
    assert turn["sigma"] == pytest.approx(10.0)  # a tenth of the 0.1 deg that are likely
    assert "overlaps 20.00 -> 15.00 um" in recalibration_text(record)
    assert "| c2 | turn y | +20.00 mdeg | 10.00 | the views |" in recalibration_lines(record)


def test_a_rig_that_fits_stays_and_without_contradiction_none_is_named() -> None:
    record = recalibration_record(found(1.2, math.nan))
    assert "stays as it is" in recalibration_text(record)
    assert "contradiction" not in recalibration_text(record)
    assert not any(line.startswith("| c2") for line in recalibration_lines(record))


def test_the_rig_keeps_its_covariance_in_its_file(tmp_path: Path) -> None:
    """A focal length stands for both of its axes: 0.03 per mille of 1152 px."""
    (tmp_path / "rig.toml").write_text(rig_text(found(40.0).rig))
    again = read_rig(tmp_path / "rig.toml")
    assert again.covariance is not None
    for number in ("fx", "fy"):
        assert again.covariance.sigma(f"c2.{number}") == pytest.approx(1152 * 3e-5, rel=1e-6)
    assert again.covariance.sigma("c2.turn_y") == pytest.approx(math.radians(0.01), rel=1e-6)
