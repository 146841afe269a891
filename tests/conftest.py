"""Recordings that many tests start from; made once."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from closed_form import SphereScene, Truth, demo_rig, simulate
from fringe3d.model import Rig, Scan
from fringe3d.patterns import sequence

SEED = 20261122

os.environ["FRINGE3D_CACHE"] = "off"  # tests leave nothing in the user's folders


@pytest.fixture(scope="session")
def rig() -> Rig:
    """Return two cameras of 320 x 256 px and a projector, all with strong distortion."""
    return demo_rig(camera_size=(320, 256))


@pytest.fixture(scope="session")
def recording(rig: Rig) -> tuple[Scan, tuple[Truth, ...]]:
    """Return a noisy recording of a sphere before a plane, with its truth: M1, 11 images."""
    assert rig.projector is not None
    plan = sequence(rig.projector.shape, periods_px=(16.0,), n_shifts=4)
    return simulate(rig, plan, SphereScene(), np.random.default_rng(SEED))


@pytest.fixture(scope="session")
def captures() -> Path:
    """Return the folder of the recordings by others; skip where it is missing."""
    default = Path(__file__).parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("FRINGE3D_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"captures: no folder {folder}; set FRINGE3D_DATA to run on real recordings")
    return folder
