"""The newest images of each camera: with every new one there is a whole sequence again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fringe3d.devices import CameraInfo, Grey
from fringe3d.model import ImageStack, PatternPlan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moment:
    """The images that all cameras took at once.

    Parameters
    ----------
    number : int; counts all moments, those that were lost, too: pattern ``number`` modulo the
        length of the plan was shown
    images : image (row, col) of each camera, by name
    time_s : float, s; on the clock of the loop
    """

    number: int
    images: Mapping[str, Grey]
    time_s: float


class SlidingWindow:
    """The newest images, as many as the plan has, in the order of the plan.

    Parameters
    ----------
    plan : PatternPlan
    infos : what the cameras say of themselves, by name; the first is C1

    Examples
    --------
    >>> from fringe3d.model.plan import fringes
    >>> window = SlidingWindow(PatternPlan(patterns=fringes(16.0, 3)),
    ...                        {"c1": CameraInfo(shape=(2, 2))})
    >>> for number in range(5):
    ...     image = np.full((2, 2), number, np.uint8)
    ...     stacks = window.add(Moment(number=number, images={"c1": image}, time_s=0.0))
    >>> stacks[0].images[:, 0, 0].tolist()
    [3, 4, 2]
    """

    def __init__(self, plan: PatternPlan, infos: Mapping[str, CameraInfo], /) -> None:
        self._plan, self._infos = plan, infos
        self._moments: list[Moment] = []

    @property
    def newest(self) -> int:
        """Return the place in the plan of the newest image; -1 where there is none."""
        return self._moments[-1].number % self._plan.n_images if self._moments else -1

    @property
    def times(self) -> tuple[int, ...]:
        """Return when the images of the plan were taken, counted in images, in its order."""
        n = self._plan.n_images
        return tuple(m.number for m in sorted(self._moments, key=lambda kept: kept.number % n))

    def add(self, moment: Moment, /) -> tuple[ImageStack, ...]:
        """Add images; return the stacks of all cameras, none until a sequence is whole.

        After a gap the window begins again: images of before would lie a whole sequence back.
        """
        n = self._plan.n_images
        if self._moments and moment.number != self._moments[-1].number + 1:
            self._moments.clear()
        self._moments = [*self._moments[1 - n :], moment] if n > 1 else [moment]
        if len(self._moments) < n:
            return ()
        ordered = sorted(self._moments, key=lambda kept: kept.number % n)
        return tuple(
            ImageStack(
                images=np.stack([kept.images[name] for kept in ordered]),
                plan=self._plan,
                device_name=name,
                saturation_dn=info.saturation_dn,
                black_level_dn=info.black_level_dn,
                noise=info.noise,
            )
            for name, info in self._infos.items()
        )
