"""How completeness and errors change with the noise and with the error of the calibration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from benchmarks.orders.cases import TRUE, Calibration, Case, Result
from benchmarks.orders.scenes import Scene

NOISES = (0.005, 0.01, 0.02, 0.03, 0.05)
ERRORS_PX = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
USUAL_NOISE, USUAL_ERROR_PX = 0.01, 0.2
SEEDS = (1, 2, 3)

LEAST_SHOWN = 1e-3
"""Per cent; the errors' scale is logarithmic."""

Curve = list[tuple[float, list[Result]]]
"""Noise or error, and the results of all draws."""


def noise_cases(
    scenes: Iterable[Scene], noises: Iterable[float], seeds: Sequence[int], /
) -> list[Case]:
    """Return the measurements of the scenes at each noise, with a usual calibration."""
    return [
        Case(replace(scene, noise=noise), Calibration(USUAL_ERROR_PX, seed))
        for scene in scenes
        for noise in noises
        for seed in seeds
    ]


def error_cases(
    scenes: Iterable[Scene], errors_px: Iterable[float], seeds: Sequence[int], /
) -> list[Case]:
    """Return the measurements of the scenes with each error, at a usual noise."""
    return [
        Case(replace(scene, noise=USUAL_NOISE), calibration)
        for scene in scenes
        for error in errors_px
        for calibration in ([Calibration(error, s) for s in seeds] if error else [TRUE])
    ]


def markdown(noisy: Sequence[Result], erring: Sequence[Result], /) -> str:
    """Return both tables: median of the draws and the worst."""
    parts = []
    for title, unit, results, by_noise in (
        (f"calibration error {USUAL_ERROR_PX:g} px", "noise, %", noisy, True),
        (f"noise {100 * USUAL_NOISE:g} %", "calibration error, px", erring, False),
    ):
        if results:
            parts.append(f"With {title}:\n\n{_table(results, unit, by_noise)}")
    return "\n\n".join(parts)


def draw(noisy: Sequence[Result], erring: Sequence[Result], file: Path, /) -> None:
    """Draw completeness above, wrong and false points below."""
    figure = Figure(figsize=(9.5, 7.0), dpi=80, layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    for column, (results, by_noise) in enumerate(((noisy, True), (erring, False))):
        lines = _curves(results, by_noise)
        colours = {thing: f"C{i}" for i, thing in enumerate(dict.fromkeys(t for _, t in lines))}
        styles = dict(zip(dict.fromkeys(p for p, _ in lines), ("-", "--", ":"), strict=False))
        for (preset, thing), curve in lines.items():
            look = {"color": colours[thing], "linestyle": styles[preset], "marker": "o", "ms": 4}
            _draw_line(axes[:, column], f"{thing}, {preset}", curve, look)
        axes[1, column].set_xlabel(
            f"noise, % of the modulation (calibration error {USUAL_ERROR_PX:g} px)"
            if by_noise
            else f"calibration error in C2, px rms (noise {100 * USUAL_NOISE:g} %)"
        )
    axes[0, 0].set_ylabel("completeness relative to M1, %")
    axes[1, 0].set_ylabel("wrong + false, % of the reference pixels")
    axes[1, 0].set_yscale("log")
    for axis in axes.flat:
        axis.grid(visible=True, alpha=0.3)
    handles, labels = next(
        (pair for axis in axes[0] if (pair := axis.get_legend_handles_labels())[0]), ([], [])
    )
    figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=9)
    figure.savefig(file)


def _draw_line(axes: Any, label: str, curve: Curve, look: dict[str, Any]) -> None:
    for axis, values_of, floor in ((axes[0], _complete, 0.0), (axes[1], _errors, LEAST_SHOWN)):
        values = [(x, sorted(max(v, floor) for v in map(values_of, found))) for x, found in curve]
        x = [at for at, _ in values]
        axis.plot(x, [v[len(v) // 2] for _, v in values], label=label, **look)
        axis.fill_between(
            x, [v[0] for _, v in values], [v[-1] for _, v in values],
            color=look["color"], alpha=0.12, linewidth=0,
        )  # fmt: skip


def _complete(result: Result) -> float:
    return result.counts.completeness


def _errors(result: Result) -> float:
    return result.counts.of_reference("wrong") + result.counts.of_reference("false")


def _curves(results: Sequence[Result], by_noise: bool) -> dict[tuple[str, str], Curve]:
    found: dict[tuple[str, str], dict[float, list[Result]]] = {}
    for result in results:
        scene = result.case.scene
        at = 100 * scene.noise if by_noise else result.case.calibration.error_px
        found.setdefault((scene.preset, scene.thing), {}).setdefault(at, []).append(result)
    return {name: sorted(curve.items(), key=lambda pair: pair[0]) for name, curve in found.items()}


def _table(results: Sequence[Result], unit: str, by_noise: bool) -> str:
    lines = [
        f"| rig | object | {unit} | completeness, % | wrong, % | false, % | of these misplaced | "
        "M1: wrong + false, % | bias refused |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for (preset, thing), curve in _curves(results, by_noise).items():
        for at, found in curve:
            cells = (
                _median_and_worst([_complete(r) for r in found], 2, largest=False),
                *(
                    _median_and_worst([r.counts.of_reference(name) for r in found], digits)
                    for name, digits in (("wrong", 3), ("false", 2), ("false_misplaced", 2))
                ),
            )
            m1 = found[0].counts
            own = m1.of_reference("m1_wrong") + m1.of_reference("m1_false")
            lines.append(
                f"| `{preset}` | {thing} | {at:g} | {' | '.join(cells)} | {own:.2f} | "
                f"{sum(r.bias_refused for r in found)} of {len(found)} |"
            )
    return "\n".join(lines) + "\n\nEach cell: median of the draws / the worst."


def _median_and_worst(values: list[float], digits: int, *, largest: bool = True) -> str:
    ordered = sorted(values)
    worst = ordered[-1 if largest else 0]
    middle = ordered[len(ordered) // 2]
    if len(ordered) == 1:
        return f"{middle:.{digits}f}"
    return f"{middle:.{digits}f} / {worst:.{digits}f}"
