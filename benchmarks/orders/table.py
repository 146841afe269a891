"""Every object on every rig: the true calibration, and five others with a bias learnt elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from benchmarks.orders.cases import TRUE, Calibration, Case, Result
from benchmarks.orders.figures import Counts
from benchmarks.orders.scenes import Scene

ERRORS_PX = (0.1, 0.15, 0.2, 0.25, 0.3)
"""Of the draws with seeds 1 to 5."""

DRAWS = tuple(Calibration(error, seed + 1) for seed, error in enumerate(ERRORS_PX))


@dataclass(frozen=True, slots=True)
class Section:
    """A table: a mode, with or without a stored bias; empty selections take all."""

    name: str
    title: str
    mode: str = "default"
    has_bias: bool = True
    presets: tuple[str, ...] = ()
    things: tuple[str, ...] = ()

    def scenes(self, scenes: Iterable[Scene], /) -> list[Scene]:
        """Return the scenes that belong into it."""
        return [
            scene
            for scene in scenes
            if scene.preset in (self.presets or (scene.preset,))
            and scene.thing in (self.things or (scene.thing,))
        ]

    def cases(self, scenes: Iterable[Scene], calibrations: Sequence[Calibration], /) -> list[Case]:
        """Return the measurements of some scenes."""
        return [
            Case(scene, calibration, self.has_bias, self.mode)
            for scene in self.scenes(scenes)
            for calibration in calibrations
        ]


SECTIONS = (
    Section("default", "Four images, bias learnt on another scan"),
    Section("strict", "The same with `--strict`", mode="strict"),
    Section("no-bias", "Four images, no stored bias", has_bias=False, presets=("kolibri",)),
    Section("gray", "One Gray image more (the finest), bias learnt on another scan",
            mode="one Gray image", things=("machine-part",)),
)  # fmt: skip

COLUMNS: tuple[tuple[str, str, int, Callable[..., float]], ...] = (
    ("completeness, %", "completeness", 2, min),
    ("wrong, %", "wrong", 3, max),
    ("false, %", "false", 2, max),
    ("of these misplaced", "false_misplaced", 2, max),
    ("where M1 has none", "false_beyond_m1", 2, max),
    ("open, %", "undecided", 2, max),
    ("M1: right, %", "m1_right", 2, min),
    ("M1: wrong, %", "m1_wrong", 3, max),
    ("M1: false, %", "m1_false", 2, max),
)
"""Title, figure, digits, and which of several draws is the worst."""


def all_cases(
    sections: Iterable[Section], scenes: Sequence[Scene], seeds: Iterable[int], /
) -> list[Case]:
    """Return all measurements; seed 0 is the true calibration."""
    wanted = set(seeds)
    calibrations = [c for c in (TRUE, *DRAWS) if c.seed in wanted]
    return [case for section in sections for case in section.cases(scenes, calibrations)]


def markdown(sections: Iterable[Section], results: Iterable[Result], /) -> str:
    """Return a table for each section: true calibration / median of the draws / the worst."""
    found = list(results)
    parts = []
    for section in sections:
        rows = [
            r for r in found if (r.case.mode, r.case.has_bias) == (section.mode, section.has_bias)
        ]
        if rows:
            parts.append(f"{section.title}:\n\n{_rows(rows)}")
    return "\n\n".join(parts)


def details(results: Iterable[Result], /) -> str:
    """Return one row for each measurement."""
    titles = " | ".join(title for title, *_ in COLUMNS)
    lines = [
        f"| rig | object | calibration | bias | mode | {titles} | s |",
        "|---|---|---|---|---|" + "---:|" * (len(COLUMNS) + 1),
    ]
    for result in results:
        case = result.case
        bias = "none" if not case.has_bias else "refused" if result.bias_refused else "stored"
        shares = result.counts.shares()
        cells = " | ".join(f"{shares[name]:.{digits}f}" for _, name, digits, _ in COLUMNS)
        lines.append(
            f"| `{case.scene.preset}` | {case.scene.thing} | {case.calibration} | {bias} | "
            f"{case.mode} | {result.failure or cells} | {result.seconds:.0f} |"
        )
    return "\n".join(lines)


def _rows(results: Sequence[Result]) -> str:
    titles = " | ".join(title for title, *_ in COLUMNS)
    lines = [
        f"| rig | object | {titles} |",
        "|---|---|" + "---:|" * len(COLUMNS),
    ]
    for scene in dict.fromkeys(r.case.scene for r in results):
        own = [r for r in results if r.case.scene == scene]
        cells = [_cell(own, *column[1:]) for column in COLUMNS]
        lines.append(f"| `{scene.preset}` | {scene.thing}{_marks(own)} | {' | '.join(cells)} |")
    notes = [
        "Each cell: true calibration / median of the draws / the worst draw.",
        *([_REFUSED] if any(r.bias_refused for r in results) else []),
        *([_FAILED] if any(r.failure for r in results) else []),
    ]
    return "\n".join(lines) + "\n\n" + "\n".join(notes)


_REFUSED = "* with some calibrations no bias was sure enough to be stored: measured without."
_FAILED = "! some measurements were refused; they count as without points."


def _marks(results: Iterable[Result]) -> str:
    found = list(results)
    marks = (("*", any(r.bias_refused for r in found)), ("!", any(r.failure for r in found)))
    return "".join(f" {mark}" for mark, is_set in marks if is_set)


def _cell(
    results: Sequence[Result], name: str, digits: int, worst: Callable[[list[float]], float]
) -> str:
    true = [r.counts for r in results if r.case.calibration == TRUE]
    draws = [r.counts for r in results if r.case.calibration != TRUE]
    shown = [_share(true[0], name)] if true else []
    if draws:
        values = sorted(_share(counts, name) for counts in draws)
        shown += [values[len(values) // 2], worst(values)]
    return " / ".join(f"{value:.{digits}f}" for value in shown)


def _share(counts: Counts, name: str) -> float:
    return counts.shares()[name]
