"""Images of a camera in one ``.npy`` file, and image files read in threads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fringe3d.io.recording import read_scan
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import ImageStack, Scan
from fringe3d.patterns import sequence

SHAPE = (24, 32)
PLAN = sequence((768, 1024), periods_px=(16.0,), n_shifts=4)


def scan_of(dtype: type[np.unsignedinteger]) -> Scan:
    """Return a scan of two cameras whose grey values are all different."""
    rng = np.random.default_rng(3)
    top = np.iinfo(dtype).max
    stacks = tuple(
        ImageStack(
            images=rng.integers(0, top, (PLAN.n_images, *SHAPE), dtype, endpoint=True),
            plan=PLAN,
            device_name=name,
            saturation_dn=top,
        )
        for name in ("c1", "c2")
    )
    return Scan(stacks=stacks)


def as_stacks(folder: Path, scan: Scan) -> None:
    """Put one file for each camera in place of its images."""
    file = folder / "scan.toml"
    text = file.read_text(encoding="utf-8")
    for stack in scan.stacks:
        name = stack.device_name
        np.save(folder / f"{name}.npy", stack.images)
        text = text.replace(f'images = "{name}/{{index:03d}}.png"', f'stack = "{name}.npy"')
    file.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_images_in_files_and_in_stacks_are_those_that_were_written(
    tmp_path: Path, dtype: type[np.unsignedinteger]
) -> None:
    """In their order, whichever thread is first."""
    scan = scan_of(dtype)
    write_scan(tmp_path, scan)
    steps: list[tuple[int, int]] = []
    files = read_scan(tmp_path, progress=lambda _work, done, total: steps.append((done, total)))
    total = 2 * PLAN.n_images
    assert steps == [(n + 1, total) for n in range(total)]
    as_stacks(tmp_path, scan)
    stacks = read_scan(tmp_path)
    for expected, one, two in zip(scan.stacks, files.stacks, stacks.stacks, strict=True):
        np.testing.assert_array_equal(expected.images, one.images)
        np.testing.assert_array_equal(expected.images, two.images)
        assert one.images.dtype == two.images.dtype == dtype
        assert one.plan == two.plan


def test_a_stack_is_mapped_and_not_copied(tmp_path: Path) -> None:
    """A change of the file shows in the images; so nothing was read before it was needed."""
    scan = scan_of(np.uint8)
    write_scan(tmp_path, scan)
    as_stacks(tmp_path, scan)
    images = read_scan(tmp_path).stacks[1].images
    file = np.load(tmp_path / "c2.npy", mmap_mode="r+")
    file[3, 5, 7] ^= 0xFF
    file.flush()
    assert images[3, 5, 7] == file[3, 5, 7] != scan.stacks[1].images[3, 5, 7]
    with pytest.raises(ValueError, match="read-only"):
        images[0, 0, 0] = 1


def test_indices_choose_the_images_of_a_stack(tmp_path: Path) -> None:
    """Recorded backwards, with one image more."""
    scan = scan_of(np.uint8)
    write_scan(tmp_path, scan)
    as_stacks(tmp_path, scan)
    numbers = list(range(PLAN.n_images, 0, -1))
    file = tmp_path / "scan.toml"
    head = f'image_indices = {numbers}\nextra_images = "ignore"\n'
    file.write_text(head + file.read_text(encoding="utf-8"), encoding="utf-8")
    for stack in scan.stacks:
        recorded = np.concatenate([stack.images[:1], stack.images[::-1]])
        np.save(tmp_path / f"{stack.device_name}.npy", recorded)
    for expected, found in zip(scan.stacks, read_scan(tmp_path).stacks, strict=True):
        np.testing.assert_array_equal(expected.images, found.images)
