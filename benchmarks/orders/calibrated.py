"""Whether the probabilities of fringe orders say what they should."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.orders.cases import Calibration, Case, Result
from benchmarks.orders.figures import DOUBT_EDGES, Reliability, pooled
from benchmarks.orders.scenes import Scene

LEAST = (0.0, 0.9, 0.99, 0.999, 0.9999, 0.99999)

FEW = 30
"""Bins with fewer points are not drawn."""

FLOOR = 3e-7


def all_cases(
    scenes: Iterable[Scene], calibrations: Sequence[Calibration], biases: Iterable[bool], /
) -> list[Case]:
    """Return measurements that keep every order, however improbable."""
    return [
        Case(scene, calibration, has_bias, "all orders")
        for has_bias in biases
        for scene in scenes
        for calibration in calibrations
    ]


def groups(results: Iterable[Result], /) -> dict[str, list[Reliability]]:
    """Return what belongs together: each rig with and without a stored bias."""
    found: dict[str, list[Reliability]] = {}
    for result in results:
        case = result.case
        stored = case.has_bias and not result.bias_refused
        name = f"{case.scene.preset}, {'stored bias' if stored else 'no stored bias'}"
        if result.reliability is not None:
            found.setdefault(name, []).append(result.reliability)
    return found


def markdown(found: Mapping[str, Sequence[Reliability]], /) -> str:
    """Return how many of the points from a probability on are wrong, and how many should be."""
    titles = " | ".join(f"p >= {least:g}" if least else "all" for least in LEAST)
    lines = [
        f"| measurements | points | calibration error, % | {titles} |",
        "|---|---:|---:|" + "---:|" * len(LEAST),
    ]
    everything = {"all": [part for parts in found.values() for part in parts]}
    for name, parts in {**found, **(everything if len(found) > 1 else {})}.items():
        one = pooled(parts)
        cells = []
        for least in LEAST:
            points, wrong, expected = one.beyond(least)
            cells.append(
                f"{100 * wrong / points:.3f} ({100 * expected / points:.3f}) of "
                f"{100 * points / one.points.sum():.1f}"
                if points
                else "-"
            )
        lines.append(
            f"| {name} | {one.points.sum():,.0f} | {100 * one.calibration_error:.2f} | "
            f"{' | '.join(cells)} |"
        )
    note = (
        "Each cell: of the points with at least this probability so many per cent are wrong "
        "(in brackets: should be, by their probabilities), and what part of all points they are, "
        "per cent. Calibration error: mean of |part wrong - mean of 1 - p| over the bins, two for "
        "each decade of 1 - p."
    )
    return "\n".join(lines) + "\n\n" + note


def draw(found: Mapping[str, Sequence[Reliability]], file: Path, /) -> None:
    """Draw the part that is wrong over the doubt 1 - p, and how many points have such a doubt."""
    figure = Figure(figsize=(7.5, 7.5), dpi=80, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot([FLOOR, 1], [FLOOR, 1], color="0.6", linewidth=1, label="as it should be")
    edges = np.maximum(DOUBT_EDGES, FLOOR)
    middles = np.sqrt(edges[1:] * edges[:-1])
    for number, (name, parts) in enumerate(found.items()):
        one = pooled(parts)
        enough = one.points >= FEW
        share = one.wrong[enough] / one.points[enough]
        doubt = np.maximum(one.doubt[enough] / one.points[enough], FLOOR)
        colour = f"C{number}"
        above.plot(doubt, np.maximum(share, FLOOR), "o-", color=colour, markersize=4, label=name)
        below.plot(middles, np.maximum(one.points / one.points.sum(), 1e-6), drawstyle="steps-mid",
                   color=colour)  # fmt: skip
    above.set(xscale="log", yscale="log", ylabel="part of the points that is wrong")
    above.text(1, FLOOR, "none", ha="right", va="center", fontsize=9, color="0.4")
    below.set(yscale="log", xlabel="1 - p, by the probability of the order",
              ylabel="part of all points")  # fmt: skip
    for axis in (above, below):
        axis.grid(visible=True, alpha=0.3)
    above.legend(fontsize=9)
    figure.savefig(file)
