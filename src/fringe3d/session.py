"""Scan after scan with the same rig and plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import keep_curves
from fringe3d.decoding import Decoded, carried_from_points, carried_on, decoded
from fringe3d.errors import CalibrationError, EmptyResultError, MethodError
from fringe3d.io.cache import mapped
from fringe3d.model import ImageStack, PatternPlan, Rig, Scan
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement, measure_decoded

LEAST_FOLLOWED = 0.9
"""Part of the points before that must be found again."""

FOLLOWING = ("m2", "m3", "m4", "m5", "m6")
"""Methods that find the orders in another way than pixel by pixel."""

MOST_CHANGE_PX, SAMPLE = 0.1, 97
"""Of the bias between frames: orders that are all off by one change it by a quarter of a pixel or
more, where cameras tell them apart at all. So many points apart it is looked at."""


class Session:
    """Measures one recording after the other; what depends on the rig alone is computed once.

    Rays, segments and light sheets are computed with the first recording, or mapped into memory
    from an earlier run's file (in the folder that the environment variable FRINGE3D_CACHE names,
    80 bytes a pixel and camera). Several threads may measure at the same time. The results are
    those of `fringe3d.pipeline.measure`, bit for bit, and own their memory.

    Parameters
    ----------
    rig : Rig or None; as in `Scan`
    plan : PatternPlan; of all recordings
    options : MeasureOptions or None (defaults)
    keep : bool; keep what depends on the rig in a file for later runs

    Examples
    --------
    >>> import numpy as np
    >>> from fringe3d.model import PatternPlan
    >>> from fringe3d.model.plan import fringes
    >>> from fringe3d.patterns import pattern_image
    >>> plan = PatternPlan(patterns=fringes(16.0, 4))
    >>> session = Session(None, plan)
    >>> images = np.stack([pattern_image(p, (8, 64)) for p in plan.patterns])
    >>> stack = ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=256)
    >>> session.measure([stack]).method
    'phase'
    """

    def __init__(
        self,
        rig: Rig | None,
        plan: PatternPlan,
        options: MeasureOptions | None = None,
        /,
        *,
        keep: bool = True,
    ) -> None:
        self.rig, self.plan, self.options = rig, plan, options or MeasureOptions()
        if keep:
            keep_curves(mapped)

    def decode(self, stacks: Sequence[ImageStack], /) -> Decoded:
        """Decode what one recording shows: the part of `measure` that needs no frame before.

        Parameters
        ----------
        stacks : sequence of ImageStack, one for each camera; the first is C1

        Raises
        ------
        MethodError
            If the images follow another plan, or plan and rig do not support the method.
        """
        for stack in stacks:
            if stack.plan != self.plan:
                raise MethodError(
                    f"session: expected images of the plan that it was made for, "
                    f"{self.plan.n_images} patterns, found another plan of {stack.plan.n_images} "
                    f"for camera '{stack.device_name}'. Make a session for each plan"
                )
        return decoded(Scan(stacks=tuple(stacks), rig=self.rig), self.options)

    def measure(
        self,
        shown: Sequence[ImageStack] | Decoded,
        /,
        *,
        previous_mm: NDArray[np.float64] | None = None,
    ) -> Measurement:
        """Measure what one recording shows.

        Parameters
        ----------
        shown : sequence of ImageStack, one for each camera, the first is C1; or what `decode` made
            of them
        previous_mm : (row, col, 3) float, mm, or None; points of the frame before, as evidence
            for M6

        Returns
        -------
        Measurement

        Raises
        ------
        MethodError
            As `decode`.
        CalibrationError, EmptyResultError
            As `fringe3d.pipeline.measure`.
        """
        shown = replace(self._decoded(shown), carried=None)
        return measure_decoded(shown, self.options, previous_mm=previous_mm)

    def follow(self, shown: Sequence[ImageStack] | Decoded, before: Measurement, /) -> Measurement:
        """Measure what one recording shows, a moment after another.

        The fringe orders go on from the points before, and both cameras must agree on them, as on
        those of a full code (M1): several times as fast as to find them. The calibration is not
        checked again by texture and projector. What moved by more than a third of a period, or came
        into view apart from all else, is missing. Where less than
        `LEAST_FOLLOWED` of the points are left, or the calibration seems to have changed, as wrong
        orders make it seem, all is measured anew.

        Parameters
        ----------
        shown : sequence of ImageStack or Decoded; as in `measure`
        before : Measurement; what `measure` or `follow` gave for the recording before

        Returns
        -------
        Measurement

        Raises
        ------
        MethodError, CalibrationError, EmptyResultError
            As `measure`.
        """
        shown = self._decoded(shown)
        if shown.rig is None or not self.may_follow(before):
            return self.measure(shown)
        carried = self.carry_on(shown, before)
        try:
            rig = replace(shown.rig, bias=None)
            found = measure_decoded(replace(carried, rig=rig), self.options)
        except (CalibrationError, EmptyResultError):
            return self.measure(shown)
        return found if self._goes_on(found, before) else self.measure(shown)

    def may_follow(self, before: Measurement, /) -> bool:
        """Tell whether orders can go on from a frame: it was measured by M2 to M6, with a bias."""
        is_of_use = before.points is not None and before.bias is not None
        return self.rig is not None and is_of_use and before.method in FOLLOWING

    def carry_on(self, shown: Decoded, before: Measurement, /) -> Decoded:
        """Return it with the fringe orders that go on from the frame before, as `follow` does it.

        The part of `follow` that needs no points where the frame before was followed, too; what has
        the orders already is returned as it is.
        """
        if shown.carried is not None and shown.carried.after is before.phases:
            return shown
        if before.main.is_absolute:
            return carried_on(shown, before.phases)
        assert before.points is not None
        return carried_from_points(shown, before.phases, before.points.points_mm)

    def _decoded(self, shown: Sequence[ImageStack] | Decoded) -> Decoded:
        return shown if isinstance(shown, Decoded) else self.decode(shown)

    def _goes_on(self, found: Measurement, before: Measurement) -> bool:
        """Tell whether as many points are found as before, and with the same bias."""
        assert self.rig is not None
        assert found.points is not None
        assert before.points is not None
        if found.points.n_points < LEAST_FOLLOWED * before.points.n_points:
            return False
        some = np.argwhere(found.points.is_valid)[::SAMPLE]
        camera = next(c for c in self.rig.cameras if c.name == found.main.device_name)
        points = found.points.points_mm[tuple(some.T)]
        depths = np.linalg.norm(points - camera.center_world, axis=1)
        now, then = (
            result.bias.displacement(some[:, ::-1].astype(np.float64), depths)
            for result in (found, before)
            if result.bias is not None
        )
        return bool(np.median(np.linalg.norm(now - then, axis=1)) < MOST_CHANGE_PX)
