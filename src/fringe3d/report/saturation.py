"""Where images are saturated, and how much of the light is fringes: maps for reports."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import Fringe, ImageStack


def saturated_images(stack: ImageStack, /) -> NDArray[np.uint16]:
    """Return how many fringe images are saturated in each pixel, (row, col).

    Of Gray code alone, how many images of any kind. Of several exposures: in the one that the
    pixel comes from.

    Examples
    --------
    >>> from fringe3d.model import PatternPlan
    >>> from fringe3d.model.plan import fringes
    >>> images = np.full((3, 1, 2), 80, np.uint8)
    >>> images[:2, 0, 1] = 255
    >>> plan = PatternPlan(patterns=fringes(16.0, 3))
    >>> saturated_images(
    ...     ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=255)
    ... ).tolist()
    [[0, 2]]
    """
    fringes = [i for i, p in enumerate(stack.plan.patterns) if isinstance(p, Fringe)]
    images = stack.images[fringes] if fringes else stack.images
    return np.asarray((images >= stack.saturation_dn).sum(axis=0), np.uint16)


def modulation_dn(stack: ImageStack, /) -> NDArray[np.float32]:
    """Return the modulation of the first fringes, (row, col), DN; half the range without fringes.

    Examples
    --------
    >>> from fringe3d.model import PatternPlan
    >>> from fringe3d.model.plan import fringes
    >>> plan = PatternPlan(patterns=fringes(16.0, 4))
    >>> images = np.array([140, 100, 60, 100], np.uint8).reshape(4, 1, 1)
    >>> modulation_dn(
    ...     ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=255)
    ... ).tolist()
    [[40.0]]
    """
    if not stack.plan.fringe_sets:
        low, high = stack.images.min(axis=0), stack.images.max(axis=0)
        return np.asarray((high.astype(np.float32) - low) / 2, np.float32)
    first = stack.plan.fringe_sets[0]
    turns = np.exp(1j * np.asarray(first.shifts))
    model = np.stack([np.ones(len(turns)), turns.real, turns.imag], axis=1)
    images = stack.images[list(first.indices)].astype(np.float32)
    cosine, sine = np.tensordot(np.linalg.pinv(model)[1:].astype(np.float32), images, axes=1)
    return np.asarray(np.hypot(cosine, sine), np.float32)
