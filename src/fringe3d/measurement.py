"""What a measurement gives: the answer and the evidence."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode import CameraPhases
from fringe3d.health import Finding
from fringe3d.model import CalibrationBias, Correspondences, PhaseMap, PointCloud, PointMap
from fringe3d.model.html import picture, table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurement:
    """The answer and the evidence.

    Parameters
    ----------
    method : str; the method used, or "phase" where there is no rig
    why : str; why this method was taken
    n_images : int; of each camera, that the method used
    phases : tuple of CameraPhases
    matches : Correspondences or None
    points : PointMap or None
    bias : CalibrationBias or None; stored or learnt, with which fringe orders were chosen
    findings : tuple of Finding; what the checks found
    seconds : dict; time of each stage
    """

    method: str
    why: str
    n_images: int
    phases: tuple[CameraPhases, ...]
    matches: Correspondences | None = None
    points: PointMap | None = None
    bias: CalibrationBias | None = None
    findings: tuple[Finding, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def main(self) -> PhaseMap:
        """Return the phase map of C1 that the points rest on."""
        return self.phases[0].directions[0].main

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Return the findings that are not ok."""
        return tuple(f for f in self.findings if f.level != "ok")

    @property
    def rejection(self) -> NDArray[np.unsignedinteger[Any]]:
        """Return the rejection map of C1."""
        return self.main.rejection if self.points is None else self.points.rejection

    def _repr_html_(self) -> str:
        rows = [("method", f"{self.method} with {self.n_images} images: {self.why}")]
        rows += [(finding.level, finding.text) for finding in self.warnings]
        shown = self.points._repr_html_() if self.points else picture(self.main.phase)
        return table("measurement", rows, more=shown)


def point_cloud(result: Measurement, /) -> PointCloud:
    """Return the points of a measurement as a plain cloud, coloured by the surface's brightness."""
    assert result.points is not None
    good = result.points.is_valid
    offset = np.nan_to_num(result.main.offset[good])
    top = max(float(np.percentile(offset, 99)), 1.0) if len(offset) else 1.0
    return PointCloud(
        points_mm=result.points.points_mm[good],
        sigma_mm=result.points.sigma_mm[good],
        grey=np.clip(255 * offset / top, 0, 255).astype(np.uint8),
        source_index=np.argwhere(good).astype(np.int32),
    )


class StageClock:
    """Times the stages of a measurement, `seconds`, and tells of each as it begins."""

    def __init__(self, stage: Callable[[str], object]) -> None:
        self._stage = stage
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time what is done within."""
        self._stage(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start
