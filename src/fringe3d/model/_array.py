"""Read-only arrays of a fixed type for the frozen nouns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


def frozen(value: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    """Return a read-only view of `value` as `dtype`.

    The data are copied only where the type differs: an image stack of a gigabyte
    is not copied. The caller's own array stays writable.
    """
    array = np.asarray(value, dtype=dtype).view()
    array.setflags(write=False)
    return array


def require_shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Raise ValueError unless `array` has `shape` (-1 matches any length)."""
    fits = array.ndim == len(shape) and all(
        want in (-1, have) for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = tuple("n" if n < 0 else n for n in shape)
        raise ValueError(f"{name}: expected shape {wanted}, found {array.shape}")


def require_finite(name: str, array: NDArray[Any]) -> None:
    """Raise ValueError if `array` holds NaN or infinity."""
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, found {array.tolist()}")
