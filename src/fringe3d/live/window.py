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
    ...     ordered = window.add(Moment(number=number, images={"c1": image}, time_s=0.0))
    >>> window.stacks(ordered)[0].images[:, 0, 0].tolist()
    [3, 4, 2]
    """

    def __init__(self, plan: PatternPlan, infos: Mapping[str, CameraInfo], /) -> None:
        self._plan, self._infos = plan, infos
        self._moments: list[Moment] = []

    @property
    def newest(self) -> int:
        """Return the place in the plan of the newest image; -1 where there is none."""
        return self._moments[-1].number % self._plan.n_images if self._moments else -1

    def add(self, moment: Moment, /) -> tuple[Moment, ...]:
        """Add images; return those of a sequence in its order, none until it is whole.

        After a gap the window begins again: images of before would lie a whole sequence back.
        """
        n = self._plan.n_images
        if self._moments and moment.number != self._moments[-1].number + 1:
            self._moments.clear()
        self._moments = [*self._moments[1 - n :], moment] if n > 1 else [moment]
        if len(self._moments) < n:
            return ()
        return tuple(sorted(self._moments, key=lambda kept: kept.number % n))

    def stacks(self, ordered: tuple[Moment, ...], /) -> tuple[ImageStack, ...]:
        """Return the images of a sequence as stacks of all cameras."""
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
