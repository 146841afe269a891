"""One measurement after the other: which rig, which images, which options, and what comes out."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.orders.figures import Counts, Reliability, reliability
from benchmarks.orders.leaving_out import NotInThisVersionError, without
from benchmarks.orders.pool import mapped
from benchmarks.orders.scenes import Recording, Scene, recorded
from fringe3d.errors import Fringe3DError
from fringe3d.model import CalibrationBias, PointMap, Rejection, Rig
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement, measure
from fringe3d.rig_bias import LEAST_CERTAINTY, learn_rig_bias
from fringe3d.simulate.perturb import perturbed

FOUR_IMAGES = MeasureOptions(method="m6", gray_bits=0, light_dark=False)
MODES = {
    "default": FOUR_IMAGES,
    "strict": replace(FOUR_IMAGES, strict=True),
    "one Gray image": replace(FOUR_IMAGES, gray_bits=1),
    "all orders": replace(FOUR_IMAGES, min_order_probability=0.0),
    "M3": replace(FOUR_IMAGES, method="m3"),
    "M3, best order": replace(FOUR_IMAGES, method="m3", min_order_probability=0.0),
}

TEACHER, OTHER_TEACHER = "two-bodies", "machine-part"
"""The bias is learnt from the first, for the first itself from the other."""


@dataclass(frozen=True, slots=True, order=True)
class Calibration:
    """Errors of a calibration: points miss by so much in C2, px (rms); 0 is the true one."""

    error_px: float
    seed: int

    def __str__(self) -> str:
        return f"error {self.error_px:g} px, seed {self.seed}" if self.error_px else "true rig"


TRUE = Calibration(0.0, 0)


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """A measurement: scene, calibration, whether a bias is stored, a mode, a part left out."""

    scene: Scene
    calibration: Calibration
    has_bias: bool = True
    mode: str = "default"
    left_out: str = ""

    @property
    def teacher(self) -> Scene:
        """Return the scene from which the bias is learnt."""
        thing = TEACHER if self.scene.thing != TEACHER else OTHER_TEACHER
        return replace(self.scene, thing=thing)

    def __str__(self) -> str:
        bias = "stored bias" if self.has_bias else "no stored bias"
        parts = (str(self.scene), str(self.calibration), bias, self.mode, self.left_out)
        return ", ".join(filter(None, parts))


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What became of a case; without a stored bias where `calibrate bias` would have refused."""

    case: Case
    counts: Counts
    seconds: float = 0.0
    bias_refused: bool = False
    failure: str = ""
    reliability: Reliability | None = None

    def record(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            **asdict(self.case),
            **asdict(self.counts),
            **self.counts.shares(),
            "seconds": round(self.seconds, 1),
            "bias_refused": self.bias_refused,
            "failure": self.failure,
            "reliability": self.reliability.record() if self.reliability else None,
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Batch:
    """Cases of one scene, and the biases that were learnt for them."""

    cases: Sequence[Case]
    biases: Mapping[Calibration, CalibrationBias | None] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.cases[0].scene}: {len(self.cases)} measurements"


@dataclass(frozen=True, slots=True, eq=False)
class _Lesson:
    """A scene from which the biases of some calibrations are learnt."""

    scene: Scene
    calibrations: Sequence[Calibration]

    def __str__(self) -> str:
        return f"{self.scene}: bias of {len(self.calibrations)} calibration(s)"


def tried(cases: Iterable[Case], /, *, jobs: int) -> list[Result]:
    """Learn the biases, measure everything, and judge it; in the order of the cases."""
    wanted = list(dict.fromkeys(cases))
    lessons: dict[Scene, set[Calibration]] = {}
    for case in wanted:
        if case.has_bias:
            lessons.setdefault(case.teacher, set()).add(case.calibration)
    learnt = mapped(
        _taught, [_Lesson(s, sorted(lessons[s])) for s in sorted(lessons)], jobs=jobs, what="bias"
    )
    biases = dict(zip(sorted(lessons), learnt, strict=True))
    batches: dict[Scene, list[Case]] = {}
    for case in wanted:
        batches.setdefault(case.scene, []).append(case)
    work = [_Batch(found, biases.get(found[0].teacher, {})) for found in batches.values()]
    results = [r for part in mapped(_judged, work, jobs=jobs, what="scene") for r in part]
    by_case = {result.case: result for result in results}
    return [by_case[case] for case in wanted]


def _rig(recording: Recording, calibration: Calibration) -> Rig:
    error, seed = calibration.error_px, calibration.seed
    return perturbed(recording.rig, rms_px=error, seed=seed, angle=recording.angle)


def _taught(lesson: _Lesson) -> dict[Calibration, CalibrationBias | None]:
    recording = recorded(lesson.scene)
    found: dict[Calibration, CalibrationBias | None] = {}
    for calibration in lesson.calibrations:
        rig = _rig(recording, calibration)
        try:
            learnt = learn_rig_bias([recording.scan], rig, FOUR_IMAGES)
        except Fringe3DError as problem:
            _note(f"  {lesson.scene}, {calibration}: {problem}")
            found[calibration] = None
            continue
        is_sure = learnt.certainty >= LEAST_CERTAINTY
        found[calibration] = learnt.bias if is_sure else None
        _note(f"  {lesson.scene}, {calibration}: {learnt.bias.rms_px:.2f} px, certainty "
              f"{learnt.certainty:.3f}{'' if is_sure else ': refused'}")  # fmt: skip
    return found


def _judged(batch: _Batch) -> list[Result]:
    recording = recorded(batch.cases[0].scene)
    m1 = {c: _by_m1(recording, c) for c in dict.fromkeys(case.calibration for case in batch.cases)}
    return [_result(case, recording, m1[case.calibration], batch.biases) for case in batch.cases]


def _by_m1(recording: Recording, calibration: Calibration) -> PointMap:
    """Return what the full code finds with the same calibration."""
    scan = replace(recording.scan, rig=_rig(recording, calibration))
    points = measure(scan, MeasureOptions(method="m1")).points
    assert points is not None
    return points


def _result(
    case: Case,
    recording: Recording,
    m1: PointMap,
    biases: Mapping[Calibration, CalibrationBias | None],
) -> Result:
    rig = _rig(recording, case.calibration)
    bias = biases[case.calibration] if case.has_bias else None
    scan = replace(recording.scan, rig=replace(rig, bias=bias))
    refused = case.has_bias and bias is None
    began = time.perf_counter()
    try:
        with without(case.left_out):
            found = measure(scan, MODES[case.mode])
    except (Fringe3DError, NotInThisVersionError) as problem:
        _note(f"  {case}: {problem}")
        counts = _counts(recording, m1, None)
        return Result(case, counts, bias_refused=refused, failure=str(problem))
    seconds = time.perf_counter() - began
    counts = _counts(recording, m1, found)
    shown = counts.shares()
    _note(f"  {case}: complete {shown['completeness']:.2f} %, wrong {shown['wrong']:.3f} %, false "
          f"{shown['false']:.2f} % ({seconds:.0f} s)")  # fmt: skip
    return Result(case, counts, seconds, refused, reliability=_reliability(recording, found))


def _counts(recording: Recording, m1: PointMap, found: Measurement | None) -> Counts:
    reference = recording.reference
    m1_right, m1_false = reference.is_right(m1), reference.is_false(m1)
    counts = Counts(
        reference=int(reference.seen.sum()),
        m1_right=int((m1_right & reference.seen).sum()),
        m1_wrong=int((m1.is_valid & ~m1_right & reference.seen).sum()),
        m1_false=int(m1_false.sum()),
    )
    if found is None or found.points is None:
        return counts
    points = found.points
    right, false = reference.is_right(points), reference.is_false(points)
    ambiguous = (points.rejection & np.uint16(Rejection.AMBIGUOUS)) != 0
    return replace(
        counts,
        right=int((right & reference.seen).sum()),
        wrong=int((points.is_valid & ~right & reference.seen).sum()),
        false=int(false.sum()),
        false_misplaced=int((false & ~right).sum()),
        false_beyond_m1=int((false & ~m1_false).sum()),
        undecided=int((ambiguous & reference.seen).sum()),
    )


def _reliability(recording: Recording, found: Measurement) -> Reliability | None:
    if found.points is None or found.matches is None or found.matches.order_probability is None:
        return None
    probability, valid = found.matches.order_probability, found.points.is_valid
    known = valid & np.isfinite(probability)
    return reliability(probability[known], recording.reference.is_right(found.points)[known])


def _note(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
