"""Print every figure about method M6 that the docs show.

    python -m benchmarks.orders table --jobs 2 --out DIR        and: curves, reliability, parts

Tables go to stdout, progress to stderr, pictures and plain data to DIR. Recordings are simulated:
640 x 512 px, 4 steps, noise 1 % of the modulation, a lit table below the object.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.orders import calibrated, curves, parts, table
from benchmarks.orders.cases import TRUE, Calibration, Case, Result, tried
from benchmarks.orders.scenes import Scene
from fringe3d.io.cache import SWITCH

PRESETS = ("designed", "kolibri", "wide-depth")
THINGS = ("plane", "prism", "machine-part", "bust", "hand", "two-bodies", "teeth")
FEW_THINGS = ("machine-part", "bust", "teeth")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one of the benchmarks."""
    options = _parser().parse_args(arguments)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        os.environ[SWITCH] = str(options.cache or folder)
        print(options.run(options))


def _scenes(options: argparse.Namespace) -> list[Scene]:
    return [
        Scene(preset, thing, options.noise, options.size)
        for preset in options.presets
        for thing in options.objects
    ]


def _tried(cases: Iterable[Case], options: argparse.Namespace, name: str) -> list[Result]:
    results = tried(cases, jobs=options.jobs)
    if options.out is not None:
        record = [result.record() for result in results]
        (options.out / f"orders-{name}.json").write_text(json.dumps(record, indent=1) + "\n")
    return results


def _table(options: argparse.Namespace) -> str:
    sections = [s for s in table.SECTIONS if s.name in options.sections]
    cases = table.all_cases(sections, _scenes(options), options.seeds)
    results = _tried(cases, options, "table")
    return table.markdown(sections, results) + (
        f"\n\n{table.details(results)}" if options.all else ""
    )


def _curves(options: argparse.Namespace) -> str:
    scenes = _scenes(options)
    noisy = curves.noise_cases(scenes, options.noises, options.seeds)
    erring = curves.error_cases(scenes, options.errors, options.seeds)
    by_case = {r.case: r for r in _tried([*noisy, *erring], options, "curves")}
    found = [by_case[case] for case in noisy], [by_case[case] for case in erring]
    if options.out is not None:
        curves.draw(*found, options.out / "orders-curves.png")
    return curves.markdown(*found)


def _reliability(options: argparse.Namespace) -> str:
    biases = {"stored": [True], "none": [False], "both": [True, False]}[options.bias]
    calibrations = [c for c in (TRUE, *table.DRAWS) if c.seed in options.seeds]
    cases = calibrated.all_cases(_scenes(options), calibrations, biases)
    found = calibrated.groups(_tried(cases, options, "reliability"))
    if options.out is not None:
        calibrated.draw(found, options.out / "orders-reliability.png")
    return calibrated.markdown(found)


def _parts(options: argparse.Namespace) -> str:
    calibrations = [Calibration(options.error, seed) for seed in options.seeds]
    rows = [row for row in parts.ROWS if options.only in parts.label(row)]
    cases = parts.all_cases(_scenes(options), calibrations, rows)
    return parts.markdown(_tried(cases, options, "parts"))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.orders",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    kinds = parser.add_subparsers(required=True, metavar="table, curves, reliability or parts")
    kind = kinds.add_parser("table", help="all objects on all rigs, five calibrations")
    _add_common(kind, PRESETS, THINGS, (0, 1, 2, 3, 4, 5))
    names = tuple(section.name for section in table.SECTIONS)
    kind.add_argument("--sections", type=_names, default=names, help=_default(names))
    kind.add_argument("--all", action="store_true", help="one row more for each measurement")
    kind.set_defaults(run=_table)
    kind = kinds.add_parser("curves", help="over noise and calibration error")
    _add_common(kind, ("designed", "kolibri"), FEW_THINGS, curves.SEEDS)
    kind.add_argument("--noises", type=_numbers, default=curves.NOISES)
    kind.add_argument("--errors", type=_numbers, default=curves.ERRORS_PX, help="px")
    kind.set_defaults(run=_curves)
    kind = kinds.add_parser("reliability", help="probabilities of orders against the truth")
    _add_common(kind, PRESETS, THINGS, (3, 4))
    kind.add_argument("--bias", choices=("stored", "none", "both"), default="both")
    kind.set_defaults(run=_reliability)
    kind = kinds.add_parser("parts", help="M3, M6, and M6 with each of its parts left out")
    _add_common(kind, ("designed", "kolibri"), FEW_THINGS, (3,))
    kind.add_argument("--error", type=float, default=0.2, help="of the calibration, px")
    kind.add_argument("--only", default="", help="rows whose name holds this")
    kind.set_defaults(run=_parts)
    return parser


def _add_common(
    parser: argparse.ArgumentParser,
    presets: tuple[str, ...],
    things: tuple[str, ...],
    seeds: tuple[int, ...],
) -> None:
    parser.add_argument("--presets", type=_names, default=presets, help=_default(presets))
    parser.add_argument("--objects", type=_names, default=things, help=_default(things))
    parser.add_argument(
        "--seeds", type=_whole_numbers, default=seeds,
        help=f"of the calibration's errors; 0 is the true one; {_default(seeds)}",
    )  # fmt: skip
    parser.add_argument("--noise", type=float, default=0.01, help="part of the modulation")
    parser.add_argument("--size", type=_size, default=(640, 512), help="of the cameras, as 640x512")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cache", type=Path, help="folder that keeps the rays of the scenes")
    parser.add_argument("--out", type=Path, help="folder for pictures and plain data")


def _default(values: Iterable[object]) -> str:
    return "default: " + ",".join(map(str, values))


def _names(text: str) -> tuple[str, ...]:
    return tuple(text.split(","))


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(",") if part)


def _whole_numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(","))


def _size(text: str) -> tuple[int, int]:
    width, height = (int(part) for part in text.split("x"))
    return width, height


if __name__ == "__main__":
    main()
