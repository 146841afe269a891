"""Compare predicted residuals of wrong orders with those in images: docs/images/margins.png.

Three rigs, four objects, four images each; about five minutes. Prints the part of the pixels of
which a wrong order fits better than the right one: what fringes alone can reach at best (M3).
Where fringes run nearly along C1's epipolar lines (the designed rig), noise of C1 counts several
times, -rho, in the residual; the band is wider there.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from fringe3d.decode import wrapped_phase
from fringe3d.design.residual import wrong_order_residuals, wrong_points
from fringe3d.design.stand import stand_of
from fringe3d.geometry import depth_interval, pixel_grid, project, rays, sheet_crossing
from fringe3d.model import PatternPlan, Rig, WrappedPhaseMap
from fringe3d.model.plan import fringes
from fringe3d.patterns import across
from fringe3d.simulate import OBJECTS, PRESETS, Stage, prepare, record
from fringe3d.simulate.perturb import perturbed

OUT = Path(__file__).parent / "images" / "margins.png"
THINGS = ("plane", "prism", "machine-part", "teeth")
SIZE = (640, 512)
PERIOD = 16.0
STEPS = 4
SHOWN = (1, -1, 2, -2)
"""Wrong orders whose residuals are drawn, less the right one."""

CALIBRATION_PX = 0.1
N_CALIBRATIONS = 3
SLACK_MM = 0.3
"""A candidate may lie that far outside the volume: noise and calibration move it."""

LEAST_COHERENCE = 0.5
"""Length of the interpolated phasor of C2; shorter ones lie on edges of what is decoded."""

CLOSE = 0.03
"""Periods; found and predicted agree."""

FLAT_MM = 0.05
"""C2 looks at the tangent plane of the point if what it sees lies that near to it: 0.02 periods."""

QUARTER = 0.25
"""Periods; the right order is known for the right one in C2, too."""

BINS = 72

Array = NDArray[Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """Images of an object, decoded, at the pixels where all devices see it in the volume."""

    stage: Stage
    maps: tuple[WrappedPhaseMap, ...]
    usable: Array
    angle: float

    @property
    def phase(self) -> Array:
        """Return the wrapped phase of C1, periods."""
        return np.asarray(self.maps[0].phase[self.usable] / (2 * np.pi))

    @property
    def order(self) -> Array:
        """Return the true fringe order."""
        u, v = np.moveaxis(self.stage.truths[0].projector_xy[self.usable], -1, 0)
        return np.asarray(np.rint(across(self.angle, u, v) / PERIOD - self.phase))


def look(rig: Rig, thing: str, angle: float) -> Seen:
    """Record an object on a table with a rig, and decode both cameras."""
    preset = PRESETS["kolibri"](SIZE)
    stage = prepare(rig, preset.scene(OBJECTS[thing]()))
    assert rig.projector is not None
    plan = PatternPlan(
        patterns=fringes(PERIOD, STEPS, angle=angle), projector_shape=rig.projector.shape
    )
    stacks = record(stage, plan, seed=1).stacks
    maps = tuple(wrapped_phase(stack, stack.plan.fringe_sets[0]) for stack in stacks)
    truth = stage.truths[0]
    usable = truth.lit & truth.in_volume & truth.seen_by["c2"] & np.isfinite(maps[0].phase)
    return Seen(stage=stage, maps=maps, usable=usable, angle=angle)


def residual(seen: Seen, rig: Rig, j: int) -> tuple[Array, Array]:
    """Return the residual of order k + j in C2's image, periods, and whether it is in the volume.

    NaN where C2 shows no phase at the place of the candidate.
    """
    assert rig.projector is not None
    assert rig.volume is not None
    camera1, camera2 = rig.cameras
    origin, directions = rays(camera1, pixel_grid(seen.usable.shape)[seen.usable])
    w = (seen.phase + seen.order + j) * PERIOD
    depth = sheet_crossing(rig.projector, origin, directions, w, seen.angle)
    near, far = depth_interval(origin, directions, rig.volume)
    inside = (depth > near - SLACK_MM) & (depth < far + SLACK_MM)
    x, y = np.moveaxis(project(camera2, origin + depth[:, None] * directions), -1, 0)
    places = np.nan_to_num([y, x], nan=-9.0)
    phase2 = seen.maps[1].phase
    phasor = np.where(np.isfinite(phase2), np.exp(1j * np.nan_to_num(phase2)), 0)
    parts = [map_coordinates(part, places, order=1) for part in (phasor.real, phasor.imag)]
    found = np.arctan2(parts[1], parts[0]) / (2 * np.pi) - seen.phase
    found = np.where(np.hypot(*parts) > LEAST_COHERENCE, found - np.rint(found), np.nan)
    return found, inside


def wrong_is_smaller(seen: Seen, rig: Rig) -> float:
    """Return the part of the pixels of which a wrong order fits better than the right one."""
    right = np.abs(residual(seen, rig, 0)[0])
    smallest = np.full(right.shape, np.inf)
    for size in range(1, 10):
        candidates = [residual(seen, rig, j) for j in (size, -size)]
        for found, inside in candidates:
            smallest = np.fmin(smallest, np.where(inside, np.abs(found), np.inf))
        if not any(inside.any() for _, inside in candidates):
            break
    return float((smallest < np.nan_to_num(right, nan=1.0)).mean())


def rigs() -> Iterator[tuple[str, Rig, float]]:
    """Yield title, rig and fringe angle, rad."""
    kolibri = PRESETS["kolibri"](SIZE).rig
    yield "kolibri: projector in the middle", kolibri, 0.0
    beside = stand_of(kolibri).placed(kolibri, *np.radians([30.0, 23.0]))
    yield "projector 5 deg beside C2", beside, 0.0
    designed = PRESETS["designed"](SIZE)
    turned = math.degrees(designed.fringe_angle)
    title = f"designed: 9 deg from C1, fringes at {turned:.0f} deg"
    yield title, designed.rig, designed.fringe_angle


def right_is_near(seen: Seen, rig: Rig) -> float:
    """Return the part of the pixels whose right order fits to a quarter of a period."""
    return float((np.abs(np.nan_to_num(residual(seen, rig, 0)[0], nan=1.0)) < QUARTER).mean())


def main() -> None:
    """Simulate, compare, draw and tell."""
    figure = Figure(figsize=(11.5, 8.0), dpi=80, layout="constrained")
    found_rigs = list(rigs())
    axes = figure.subplots(2, len(found_rigs), sharex=True, sharey=True)
    for col, (title, rig, angle) in enumerate(found_rigs):
        everything = []
        tell(f"{title}\n")
        for thing in THINGS:
            seen = look(rig, thing, angle)
            pairs = np.concatenate([compare(seen, rig, j) for j in SHOWN])
            everything.append(pairs)
            tell(f"  {thing:13}{describe(seen, rig)}; {told(pairs)}\n")
        pooled = np.concatenate(everything)
        draw(axes[0, col], pooled, title)
        draw(axes[1, col], pooled[pooled[:, 2] < FLAT_MM], "")
        tell(f"  all          {told(pooled)}\n")
    axes[0, 0].set_ylabel("all pixels\nfound in the images, periods")
    axes[1, 0].set_ylabel("where C2 sees the tangent plane\nfound in the images, periods")
    for axis in axes[-1]:
        axis.set_xlabel("predicted from the true normal, periods")
    figure.suptitle(
        "Residual in C2 of the wrong orders k +- 1, k +- 2: plane, prism, machine part and teeth",
        fontsize=11, x=0.01, ha="left",
    )  # fmt: skip
    figure.savefig(OUT)


def describe(seen: Seen, rig: Rig) -> str:
    """Tell how often a wrong order fits better, with a perfect and with other calibrations."""
    guesses = [
        perturbed(rig, rms_px=CALIBRATION_PX, seed=seed, angle=seen.angle)
        for seed in range(1, N_CALIBRATIONS + 1)
    ]
    wrong = [f"{100 * wrong_is_smaller(seen, guess):.2f}" for guess in (rig, *guesses)]
    near = [f"{100 * right_is_near(seen, guess):.1f}" for guess in (rig, *guesses)]
    return (
        f"{seen.usable.sum():7,} pixels; wrong order fits better on {wrong[0]} %, calibration off "
        f"by {CALIBRATION_PX:g} px: {', '.join(wrong[1:])} %; right order within a quarter period "
        f"on {near[0]} % ({', '.join(near[1:])} %)"
    )


def compare(seen: Seen, rig: Rig, j: int) -> Array:
    """Return predicted and found residuals, periods, -1/2 to 1/2, and the distance, mm, (n, 3).

    The distance is that of what C2 sees there, by its truth, from the tangent plane.
    """
    truth, truth2 = seen.stage.truths
    points, normals = truth.points_mm[seen.usable], truth.normals[seen.usable]
    options = {"period_px": PERIOD, "angle": seen.angle}
    predicted = wrong_order_residuals(rig, points, normals, [j], **options)[:, 0]
    wrong = wrong_points(rig, points, [j], **options)[:, 0]
    x, y = np.moveaxis(project(rig.cameras[1], wrong), -1, 0)
    places = np.nan_to_num([y, x], nan=-9.0)
    looked_at = np.stack(
        [
            map_coordinates(truth2.points_mm[..., axis], places, order=1, cval=np.nan)
            for axis in range(3)
        ],
        axis=-1,
    )
    away = np.abs(((looked_at - points) * normals).sum(axis=-1))
    found, _ = residual(seen, rig, j)
    all_three = np.stack([predicted - np.rint(predicted), found, away], axis=-1)
    return np.asarray(all_three[np.isfinite(all_three).all(axis=1)])


def told(pairs: Array) -> str:
    """Return the agreement in words."""
    flat = pairs[pairs[:, 2] < FLAT_MM]
    return (
        f"prediction within {CLOSE:g} periods on {agreement(pairs):.1f} %, on {agreement(flat):.1f}"
        f" % of the {100 * len(flat) / len(pairs):.0f} % where C2 sees the tangent plane"
    )


def agreement(pairs: Array) -> float:
    """Return the part of the pairs that agree, modulo a period, per cent."""
    away = pairs[:, 1] - pairs[:, 0]
    return float(100 * (np.abs(away - np.rint(away)) < CLOSE).mean())


def draw(axis: Any, pairs: Array, title: str) -> None:
    """Draw predicted against found residuals."""
    edges = np.linspace(-0.5, 0.5, BINS + 1)
    counts, _, _ = np.histogram2d(pairs[:, 1], pairs[:, 0], bins=edges)
    axis.imshow(np.log10(np.maximum(counts, 0.5)), origin="lower", extent=(-0.5, 0.5, -0.5, 0.5),
                cmap="magma_r", vmin=0, interpolation="nearest")  # fmt: skip
    axis.set(xlim=(-0.5, 0.5), ylim=(-0.5, 0.5))
    axis.set_title(title, fontsize=9.5)
    axis.text(-0.47, 0.42, f"{agreement(pairs):.0f} % agree within {CLOSE:g} periods", fontsize=9.5,
              bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8})  # fmt: skip


def tell(text: str) -> None:
    """Print a part of a line."""
    sys.stdout.write(text)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
