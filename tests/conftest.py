"""Recordings and settings that many tests start from."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numba
import pytest

from closed_form import Recording, SphereScene, demo_rig, record_scene
from fringe3d import kernels
from fringe3d.model import Rig

SEED = 20261122

os.environ["FRINGE3D_CACHE"] = "off"  # tests leave nothing in the user's folders

# Said once in a process, of whichever test compiles first: test_kernels tests it in its own.
kernels._KNOWN.add("fringe3d")
kernels._LISTENING.discard("fringe3d")


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Do without threads: for many small arrays they cost more than they help."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


@pytest.fixture(scope="session")
def rig() -> Rig:
    """Return two cameras of 320 x 256 px and a projector, all with strong distortion."""
    return demo_rig(camera_size=(320, 256))


@pytest.fixture(scope="session")
def recording(rig: Rig) -> Recording:
    """Return a noisy recording of a sphere before a plane, with its truth: M1, 11 images."""
    return record_scene(rig, SphereScene(), seed=SEED)


@pytest.fixture(scope="session")
def captures() -> Path:
    """Return the folder of the recordings by others; skip where it is missing."""
    default = Path(__file__).parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("FRINGE3D_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"captures: no folder {folder}; set FRINGE3D_DATA to run on real recordings")
    return folder
