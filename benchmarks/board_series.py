"""Calibrations by a board against the truth, run for run.

python -m benchmarks.board_series corners --runs 40           projected corners, 0.05 px of noise
python -m benchmarks.board_series images --runs 10            rendered images; minutes for each run
python -m benchmarks.board_series images --board circles:9x7:20mm --preset wide-depth

Prints, for each run and for all: pull of all numbers of the devices (error over sigma, rms), the
part of them within 3 sigma, the trinocular bias over the measuring volume in periods (rms), and by
how much the form of points is wrong, um (rms).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.board_scans import board_image, views_of_scan
from fringe3d.calibrate import (
    BOARD_LENSES,
    BoardCalibration,
    BoardOptions,
    BoardView,
    DeviceSize,
    calibrate_board,
    circle_centers,
    compare_rigs,
)
from fringe3d.geometry import closest_depths, project, rays
from fringe3d.io.board_images import find_corners
from fringe3d.io.boardfile import read_board
from fringe3d.model import Board, Device, Rig, RigidTransform
from fringe3d.model.covariance import LENS_NUMBERS
from fringe3d.patterns import method_plan
from fringe3d.simulate import PRESETS, Preset, prepare, record
from fringe3d.simulate.boards import board_poses, printed_board

Floats = NDArray[np.float64]

N_POSES = 12
NOISE_PX = 0.05
GRID = 9


@dataclass(frozen=True)
class Judged:
    """What one calibration is worth."""

    pulls: Floats
    trinocular_periods: float
    form_mm: float
    points_mm: float


def projected_views(preset: Preset, board: Board, points: Floats, seed: int) -> list[BoardView]:
    """Return corners as OpenCV projects them, with noise."""
    rng = np.random.default_rng([seed, 1])
    views = []
    for number, pose in enumerate(_poses(preset, board, seed)):
        for device in preset.rig.devices:
            place = device.device_from_world @ pose
            turn = Rotation.from_matrix(place.rotation).as_rotvec()
            pixels = cv2.projectPoints(points, turn, place.translation, device.camera_matrix,
                                       device.distortion)[0].reshape(-1, 2)  # fmt: skip
            seen = ((pixels >= 0) & (pixels < [device.n_cols, device.n_rows])).all(axis=1)
            noisy = pixels + rng.normal(0, NOISE_PX, pixels.shape)
            views.append(
                BoardView(device=device.name, pose=f"{number:03d}", ids=np.flatnonzero(seen),
                          pixels=noisy[seen], via="c1" if device.role == "projector" else "")
            )  # fmt: skip
    return views


def rendered_views(
    preset: Preset, board: Board, thing: object, seed: int, *, raw_circles: bool
) -> list[BoardView]:
    """Return corners as they are found in rendered images."""
    assert preset.rig.projector is not None
    plan = method_plan("m0", preset.rig.projector.shape, period_px=preset.period_px, n_shifts=4)
    scene = preset.scene(thing.mesh, None, background="wall", scaled=False)  # type: ignore[attr-defined]
    views: list[BoardView] = []
    for number, pose in enumerate(_poses(preset, board, seed)):
        stage = prepare(preset.rig, scene.placed(pose))
        scan = record(stage, plan, seed=seed, position=number)
        corners = {}
        for stack in scan.stacks:
            found = find_corners(board_image(stack), board)
            pixels = found.pixels
            if found.areas is not None and not raw_circles and len(found):
                pixels = circle_centers(board, found.ids, pixels, found.areas)
            corners[stack.device_name] = (found.ids, pixels)
        views += views_of_scan(scan, board, corners, pose=f"{number:03d}", projector="projector")
    return views


def _poses(preset: Preset, board: Board, seed: int) -> tuple[RigidTransform, ...]:
    return board_poses(
        board, N_POSES, diameter_mm=preset.diameter_mm, height_mm=preset.height_mm, seed=seed
    )


def judged(found: BoardCalibration, preset: Preset) -> Judged:
    """Compare with the true rig."""
    true = [_in_first(d, preset.rig.cameras[0]) for d in preset.rig.devices]
    off = _errors(found.devices, true)
    names = found.covariance.names
    pulls = np.array([off[name] / found.covariance.sigma(name) for name in names])
    volume = _volume(preset)
    points = preset.rig.cameras[0].device_from_world.apply(volume)
    period = preset.period_px
    w = _w(true, found.devices, points)
    compared = compare_rigs(
        Rig(cameras=tuple(found.devices[:2])), Rig(cameras=tuple(true[:2])), points
    )
    return Judged(
        pulls=pulls,
        trinocular_periods=float(np.sqrt(np.nanmean(w**2))) / period,
        form_mm=compared.form_rms_mm,
        points_mm=compared.moved_rms_mm,
    )


def _in_first(device: Device, first: Device) -> Device:
    pose = device.device_from_world @ first.device_from_world.inverse()
    return replace(device, device_from_world=pose)


def _volume(preset: Preset) -> Floats:
    """Return points all over the measuring volume, world frame, mm."""
    x = np.linspace(-0.5, 0.5, GRID) * preset.diameter_mm
    z = np.linspace(-0.48, 0.48, GRID) * preset.height_mm
    points = np.stack(np.meshgrid(x, x, z), axis=-1).reshape(-1, 3)
    assert preset.rig.volume is not None
    return np.asarray(points[preset.rig.volume.contains(points)])


def _w(true: Sequence[Device], found: Sequence[Device], points: Floats) -> Floats:
    """Return the trinocular bias: x of the found projector at points of the found cameras, less
    the true one, projector px."""
    o1, d1 = rays(found[0], project(true[0], points))
    o2, d2 = rays(found[1], project(true[1], points))
    t, _ = closest_depths(o1, d1, o2, d2)
    here = o1 + t[:, None] * d1
    return np.asarray((project(found[2], here) - project(true[2], points))[:, 0])


def _errors(found: Sequence[Device], true: Sequence[Device]) -> dict[str, float]:
    result: dict[str, float] = {}
    for a, b in zip(found, true, strict=True):
        values = [np.r_[d.focal_px, d.center_px, d.distortion[:8]] for d in (a, b)]
        off = a.device_from_world @ b.device_from_world.inverse()
        numbers = np.r_[values[0] - values[1], Rotation.from_matrix(off.rotation).as_rotvec(),
                        off.translation]  # fmt: skip
        poses = [f"{kind}_{axis}" for kind in ("turn", "shift") for axis in "xyz"]
        result |= {
            f"{b.name}.{n}": float(v) for n, v in zip([*LENS_NUMBERS, *poses], numbers, strict=True)
        }
    return result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("corners", "images"))
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--preset", default="kolibri")
    parser.add_argument("--board", default="chessboard:9x7:6mm")
    parser.add_argument("--camera-size", default="640x512")
    parser.add_argument("--bend", type=float, default=0.0)
    parser.add_argument("--shape", choices=("flat", "bent", "free"))
    parser.add_argument("--lens", choices=BOARD_LENSES)
    parser.add_argument("--raw-circles", action="store_true", help="middles of ellipses")
    options = parser.parse_args()
    size = tuple(map(int, options.camera_size.split("x")))
    preset = PRESETS[options.preset]((size[0], size[1]))
    board = read_board(options.board)
    sizes = [DeviceSize(name=d.name, role=d.role, shape=d.shape) for d in preset.rig.devices]
    print(
        "| run | pull | within 3 sigma | trinocular, periods | form, um | points, um | noise, px |"
    )
    print("|---|---|---|---|---|---|---|")
    all_found: list[Judged] = []
    for seed in range(options.first, options.first + options.runs):
        thing = printed_board(board, bend_mm=options.bend, seed=seed)
        if options.what == "corners":
            views = projected_views(preset, board, thing.points_mm, seed)
        else:
            views = rendered_views(preset, board, thing, seed, raw_circles=options.raw_circles)
        wanted = BoardOptions(lens=options.lens, shape=options.shape)
        found = calibrate_board(board, views, sizes, wanted)
        one = judged(found, preset)
        all_found.append(one)
        noise = " ".join(f"{v:.3f}" for v in found.noise_px.values())
        print(_row(str(seed), [one]), f"{noise} |", flush=True)
    print(_row("all", all_found), " |")


def _row(name: str, found: Sequence[Judged]) -> str:
    pulls = np.concatenate([f.pulls for f in found])
    rms = [float(np.sqrt(np.mean(np.square([getattr(f, key) for f in found]))))
           for key in ("trinocular_periods", "form_mm", "points_mm")]  # fmt: skip
    return (
        f"| {name} | {np.sqrt(np.mean(pulls**2)):.3f} | {(np.abs(pulls) < 3).mean():.1%} | "
        f"{rms[0]:.4f} | {1e3 * rms[1]:.1f} | {1e3 * rms[2]:.0f} |"
    )


if __name__ == "__main__":
    main()
