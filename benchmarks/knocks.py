"""Devices that were knocked by 0.05 degrees and 0.1 mm: what `measure` says, what it finds again.

    python -m benchmarks.knocks warned     rigs with the covariance of a board calibration
    python -m benchmarks.knocks found      four images without a code, poses found from themselves

Scans are rendered: `kolibri`, 640 x 512 px, full Gray code in both directions.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.board_series import projected_views
from fringe3d.calibrate import BoardOptions, DeviceSize, calibrate_board
from fringe3d.errors import Fringe3DError
from fringe3d.io.boardfile import read_board
from fringe3d.model import Rig, Scan
from fringe3d.options import MeasureOptions
from fringe3d.patterns import across, method_plan
from fringe3d.pipeline import measure
from fringe3d.self_calibration import self_calibrate
from fringe3d.simulate import OBJECTS, PRESETS, Preset, Truth, knocked, prepare, record

TURN_DEG, SHIFT_MM = 0.05, 0.1
THINGS = ("machine-part", "plane", "teeth")
DIRECTIONS = {"two": MeasureOptions(), "one": MeasureOptions(direction="x")}
NO_CODE = MeasureOptions(method="m6", direction="x", gray_bits=0)
N_CALIBRATIONS, N_KNOCKS, N_SEARCHES = 2, 4, 2


def main() -> None:
    """Print one of the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("warned", "found"))
    rows = {"warned": warned, "found": found}[parser.parse_args().what]
    for row in rows():
        print("| " + " | ".join(row) + " |", flush=True)


def with_knocked(rig: Rig, *names: str, seed: int) -> Rig:
    """Return the rig, some of its devices knocked."""
    for number, device in enumerate(rig.devices):
        if device.name in names:
            rig = knocked(rig, device.name, turn_deg=TURN_DEG, shift_mm=SHIFT_MM,
                          seed=seed + number)  # fmt: skip
    return rig


@cache
def recorded(thing: str) -> tuple[Scan, Truth, Preset]:
    """Simulate a scan."""
    preset = PRESETS["kolibri"]((640, 512))
    assert preset.rig.projector is not None
    stage = prepare(preset.rig, preset.scene(OBJECTS[thing]()))
    plan = method_plan("m0", preset.rig.projector.shape, period_px=preset.period_px, n_shifts=4)
    return record(stage, plan, seed=1), stage.truths[0], preset


def calibrated(preset: Preset, seed: int) -> Rig:
    """Return what 12 poses of a board make of a rig, and how sure it is."""
    board = read_board("chessboard:9x7:6mm")
    sizes = [DeviceSize(name=d.name, role=d.role, shape=d.shape) for d in preset.rig.devices]
    views = projected_views(preset, board, board.points_mm, seed)
    own = calibrate_board(board, views, sizes, BoardOptions(shape="flat"))
    own = own.in_world(preset.rig.cameras[0].device_from_world)
    *cameras, projector = own.devices
    return replace(
        preset.rig, cameras=tuple(cameras), projector=projector, covariance=own.covariance
    )


def told(scan: Scan, rig: Rig, options: MeasureOptions) -> str:
    """Return what `measure` says of devices that moved; refusals included."""
    try:
        findings = measure(replace(scan, rig=rig), options).findings
    except Fringe3DError as problem:
        return str(problem)
    return " ".join(f.text for f in findings if f.name == "moved_px")


def warned() -> Iterator[tuple[str, ...]]:
    """Yield how often it warns of rigs that stand, and of each device that was knocked."""
    yield "fringes of", "false alarms", "warned", "named right", "named wrong"
    for name, options in DIRECTIONS.items():
        count: Counter[str] = Counter()
        for thing in THINGS:
            scan, _, preset = recorded(thing)
            for seed in range(N_CALIBRATIONS):
                rig = calibrated(preset, seed)
                count["stand"] += 1
                count["false"] += bool(told(scan, rig, options))
                if seed > 0:
                    continue
                for number, device in enumerate(rig.devices):
                    for knock in range(N_KNOCKS):
                        moved = with_knocked(rig, device.name, seed=100 * number + 10 * knock)
                        text = told(scan, moved, options)
                        is_right = f"device '{device.name}' has moved" in text
                        count["knocked"] += 1
                        count["warned"] += bool(text)
                        count["right"] += is_right
                        count["wrong"] += "has moved" in text and not is_right
        yield (name, f"{count['false']} of {count['stand']}",
               f"{count['warned']} of {count['knocked']}", str(count["right"]),
               str(count["wrong"]))  # fmt: skip


def found() -> Iterator[tuple[str, ...]]:
    """Yield the part of the pixels with the right order, before and after."""
    yield "from", "true rig, %", "moved, %", "self-calibrated, %"
    for thing in THINGS:
        scan, truth, preset = recorded(thing)
        moved = [with_knocked(preset.rig, "c2", "projector", seed=1000 * k)
                 for k in range(N_SEARCHES)]  # fmt: skip
        again = []
        for rig in moved:
            try:
                own = self_calibrate([scan], rig, NO_CODE).rig
                again.append(right_part(scan, own, truth, preset))
            except Fringe3DError:
                again.append("refused")
        before = [right_part(scan, rig, truth, preset) for rig in moved]
        yield (thing, right_part(scan, preset.rig, truth, preset), ", ".join(before),
               ", ".join(again))  # fmt: skip


def right_part(scan: Scan, rig: Rig, truth: Truth, preset: Preset) -> str:
    """Return which part of what is lit and seen by both has its order by M6, per cent."""
    try:
        result = measure(replace(scan, rig=rig), NO_CODE)
    except Fringe3DError:
        return "refused"
    assert result.matches is not None
    seen = truth.lit & truth.in_volume & truth.seen_by["c2"]
    x, y = np.moveaxis(truth.projector_xy, -1, 0)
    order = np.floor(across(0.0, x, y) / preset.period_px)
    right = (result.rejection == 0) & (result.matches.fringe_order == order)
    return f"{100 * (right & seen).sum() / seen.sum():.2f}"


if __name__ == "__main__":
    main()
