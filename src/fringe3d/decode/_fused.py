"""From grey values to phase, modulation, fringe order and reasons in one pass, compiled.

Rows are worked on in tiles that stay in the processor's first cache: every image byte comes from
memory once, every result goes there once. The inner loops run over the pixels of a row without a
branch, so that they become vector instructions; all images of one pixel after the other are
slower than NumPy. `wrapped_phase` and `order_from_code` with ``plain=True`` say the same in words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fringe3d.model import NO_ORDER, Rejection

f4, i4, u2 = np.float32, np.int32, np.uint16

TILE = 1024
"""Columns at once: their scratch of 45 KiB stays in the first two caches, and each image is read in
stretches long enough to be foreseen."""

ROWS_AT_ONCE = 16
"""Rows that share one scratch and go to one thread."""

TOGETHER = 4
"""Images that one sweep adds up; lists of steps are filled up to it with weights of zero."""

PHASE_BINS = 16
"""Parts of a period in which the code is looked up; a cell of half a period holds eight."""

CORRECTED, UNSAFE, CLEAR = 1, 2, 4
"""Lowest bits of an entry of the table: the word alone means another order; it has an
alternative. Above two bits: 0 for no order, else 1 + its place. CLEAR only in `Maps.cells`."""

# Parts of the scratch of a tile: A as recorded, C, S, phase, B, sigma, threshold, contrast.
OFFSET, COSINE, SINE, PHASE, MODULATION, SIGMA, THRESHOLD, CONTRAST = range(0, 8 * TILE, TILE)
N_SCRATCH = 8 * TILE

PI, HALF_PI, TWO_PI = f4(np.pi), f4(np.pi / 2), f4(2 * np.pi)
BINS_PER_RAD = f4(PHASE_BINS / (2 * np.pi))
ZERO, HALF, TINY, NAN, FAR = f4(0), f4(0.5), f4(1e-30), f4(np.nan), f4(np.inf)

A1, A3, A5, A7 = f4(0.9999993443), f4(-0.3332985938), f4(0.1994656622), f4(-0.1390862912)
A9, A11, A13, A15 = f4(0.0964219570), f4(-0.0559123009), f4(0.0218629390), f4(-0.0040545622)
"""Odd polynomial of least largest error, 3.8e-8 rad, for the arctangent of 0..1."""

NOTHING, NONE = u2(0), i4(NO_ORDER)
SATURATED, LOW = u2(Rejection.SATURATED), u2(Rejection.LOW_MODULATION)
CONTRADICTS = u2(Rejection.INCONSISTENT_CODE)

FLAGS = {"contract", "nsz"}  # multiply and add in one step; NaN and infinity stay what they are


class Steps(NamedTuple):
    """Fringe images: places in the stack, and (3, n) weights of A, C and S; n a multiple of 4."""

    places: NDArray[np.int64]
    weights: NDArray[np.float32]


class Numbers(NamedTuple):
    """Limits and noise, DN: sigma is ``weight * sqrt(read_variance + gain * light) / B``."""

    black: np.float32
    saturation: np.float32
    lowest: np.float32
    max_std: np.float32
    weight: np.float32
    read_variance: np.float32
    gain: np.float32
    full_scale: np.float32


class Code(NamedTuple):
    """Gray code: places of bits and inverses (-1: none), packed table, first order.

    `offset` is the (row, col) light that bits are compared with, (0, 0) for that of the steps.
    """

    bits: NDArray[np.int64]
    inverses: NDArray[np.int64]
    table: NDArray[np.int32]
    first_order: np.int32
    clear_part: np.float32
    offset: NDArray[np.float32]


class Maps(NamedTuple):
    """Results, all (row, col). The second line is (0, 0) where no order is asked for.

    `cells` is (0, 0) unless the table has alternatives: entry of the table, shifted by 3, with
    `UNSAFE` and `CLEAR`. `counts` (row, 2) are valid pixels and corrected orders.
    """

    offset: NDArray[np.float32]
    modulation: NDArray[np.float32]
    sigma: NDArray[np.float32]
    wrapped: NDArray[np.float32]
    reason: NDArray[np.uint16]
    phase: NDArray[np.float32]
    order: NDArray[np.int32]
    rejection: NDArray[np.uint16]
    cells: NDArray[np.int32]
    counts: NDArray[np.int64]


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def arctangent(y, x):  # type: ignore[no-untyped-def]
    """Return atan2(y, x) of single-precision numbers within 4e-7 rad, in (-pi, pi]."""
    long, short = max(abs(x), abs(y)), min(abs(x), abs(y))
    t = short / max(long, TINY)
    s = t * t
    high = A9 + s * (A11 + s * (A13 + s * A15))
    angle = t * (A1 + s * (A3 + s * (A5 + s * (A7 + s * high))))
    angle = HALF_PI - angle if abs(y) > abs(x) else angle
    angle = PI - angle if x < ZERO else angle
    return -angle if y < ZERO else angle


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _sum_steps(images, steps, row, left, right, work):  # type: ignore[no-untyped-def]
    """Write A, C and S of a tile."""
    work[: 3 * TILE] = ZERO
    a, c, s = steps.weights[0], steps.weights[1], steps.weights[2]
    for g in range(0, len(steps.places), TOGETHER):
        p0, p1 = steps.places[g], steps.places[g + 1]
        p2, p3 = steps.places[g + 2], steps.places[g + 3]
        im0, im1 = images[p0, row, left:right], images[p1, row, left:right]
        im2, im3 = images[p2, row, left:right], images[p3, row, left:right]
        a0, a1, a2, a3 = a[g], a[g + 1], a[g + 2], a[g + 3]
        c0, c1, c2, c3 = c[g], c[g + 1], c[g + 2], c[g + 3]
        s0, s1, s2, s3 = s[g], s[g + 1], s[g + 2], s[g + 3]
        for x in range(right - left):
            v0, v1, v2, v3 = f4(im0[x]), f4(im1[x]), f4(im2[x]), f4(im3[x])
            work[OFFSET + x] += a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
            work[COSINE + x] += c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3
            work[SINE + x] += s0 * v0 + s1 * v1 + s2 * v2 + s3 * v3


@njit(cache=True)
def _brightest_step(images, places, row, left, right, brightest):  # type: ignore[no-untyped-def]
    """Write the largest grey value of the steps."""
    brightest[:] = 0
    for g in range(0, len(places), TOGETHER):
        im0, im1 = images[places[g], row, left:right], images[places[g + 1], row, left:right]
        im2, im3 = images[places[g + 2], row, left:right], images[places[g + 3], row, left:right]
        for x in range(right - left):
            pair = max(max(im0[x], im1[x]), max(im2[x], im3[x]))
            brightest[x] = max(brightest[x], pair)


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _phase(n, numbers, work):  # type: ignore[no-untyped-def]
    """Turn A, C, S of a tile into phase, modulation and sigma of the phase."""
    scale = numbers.weight * np.sqrt(numbers.read_variance)
    for x in range(n):
        cosine, sine = work[COSINE + x], work[SINE + x]
        modulation = np.sqrt(cosine * cosine + sine * sine)
        work[MODULATION + x] = modulation
        work[SIGMA + x] = scale / modulation
        work[PHASE + x] = arctangent(sine, cosine)
    if numbers.gain > ZERO:
        for x in range(n):
            light = max(work[OFFSET + x] - numbers.black, ZERO)
            noise = np.sqrt(numbers.read_variance + numbers.gain * light)
            work[SIGMA + x] = numbers.weight * noise / work[MODULATION + x]


@njit(cache=True)
def _judge(brightest, numbers, work, reason):  # type: ignore[no-untyped-def]
    """Write the reasons of a tile; return the number of pixels without any."""
    saturation, lowest, max_std = numbers.saturation, numbers.lowest, numbers.max_std
    for x in range(len(reason)):
        good = (work[MODULATION + x] >= lowest) & (work[SIGMA + x] <= max_std)
        too_bright = SATURATED if f4(brightest[x]) >= saturation else NOTHING
        reason[x] = too_bright | (NOTHING if good else LOW)
    n_valid = i4(0)
    for x in range(len(reason)):
        n_valid += i4(1) if reason[x] == NOTHING else i4(0)
    return n_valid


@njit(cache=True)
def _store_offset(black, work, offset):  # type: ignore[no-untyped-def]
    for x in range(len(offset)):
        offset[x] = work[OFFSET + x] - black


@njit(cache=True)
def _store_phase(work, reason, result):  # type: ignore[no-untyped-def]
    for x in range(len(reason)):
        result[x] = work[PHASE + x] if reason[x] == NOTHING else NAN


@njit(cache=True)
def _make_positive(n, work):  # type: ignore[no-untyped-def]
    """Move the phase of a tile to [0, 2 pi)."""
    for x in range(n):
        phase = work[PHASE + x]
        phase = phase + TWO_PI if phase < ZERO else phase
        work[PHASE + x] = phase if phase < TWO_PI else ZERO


@njit(cache=True)
def _threshold(offset, numbers, work, below, above):  # type: ignore[no-untyped-def]
    """Write the threshold of the code, and round it: whole grey values compare as with itself."""
    for x in range(len(below)):
        recorded = offset[x] + numbers.black
        work[THRESHOLD + x] = min(max(recorded, ZERO), numbers.full_scale)
    for x in range(len(below)):
        below[x] = i4(np.floor(work[THRESHOLD + x]))
    for x in range(len(below)):
        above[x] = i4(np.ceil(work[THRESHOLD + x]))


@njit(cache=True)
def _append_bit(bright, dark, word):  # type: ignore[no-untyped-def]
    for x in range(len(word)):
        word[x] = (word[x] << u2(1)) | u2(bright[x] > dark[x])


@njit(cache=True)
def _read_words(images, code, row, left, right, below, above, word):  # type: ignore[no-untyped-def]
    """Write the code words of a tile; see `gray.code_words`."""
    word[:] = NOTHING
    for b in range(len(code.bits)):
        bit = images[code.bits[b], row, left:right]
        inverse = images[code.inverses[b], row, left:right]
        if code.inverses[b] < 0:
            _append_bit(bit, below, word)
        elif code.bits[b] < 0:
            _append_bit(above, inverse, word)
        else:
            _append_bit(bit, inverse, word)


@njit(cache=True)
def _contrast(images, code, row, left, right, work):  # type: ignore[no-untyped-def]
    """Write the smallest distance of a bit from its threshold."""
    n = right - left
    work[CONTRAST : CONTRAST + n] = FAR
    for b in range(len(code.bits)):
        bit = images[code.bits[b], row, left:right]
        inverse = images[code.inverses[b], row, left:right]
        if code.bits[b] >= 0 and code.inverses[b] >= 0:
            for x in range(n):
                distance = abs(f4(bit[x]) - f4(inverse[x])) * HALF
                work[CONTRAST + x] = min(work[CONTRAST + x], distance)
        else:
            image = bit if code.bits[b] >= 0 else inverse
            for x in range(n):
                distance = abs(f4(image[x]) - work[THRESHOLD + x])
                work[CONTRAST + x] = min(work[CONTRAST + x], distance)


@njit(cache=True)
def _look_up(table, work, word, entry):  # type: ignore[no-untyped-def]
    """Write the entries of the table for the words and phases of a tile."""
    for x in range(len(word)):
        part = i4(work[PHASE + x] * BINS_PER_RAD) & i4(PHASE_BINS - 1)
        entry[x] = i4(word[x]) * i4(PHASE_BINS) + part
    for x in range(len(word)):
        entry[x] = table[entry[x]]


@njit(cache=True)
def _store_cells(code, work, word, reason, entry, cells):  # type: ignore[no-untyped-def]
    """Write what `mend_at_edges` asks for; 0 where the pixel is rejected."""
    for x in range(len(word)):
        part = i4(work[PHASE + x] * BINS_PER_RAD) & i4(PHASE_BINS - 1)
        clear = work[CONTRAST + x] >= code.clear_part * work[MODULATION + x]
        bits = (entry[x] & i4(UNSAFE)) | (i4(CLEAR) if clear else i4(0))
        place = (i4(word[x]) * i4(PHASE_BINS) + part) * i4(8)
        cells[x] = place | bits if reason[x] == NOTHING else i4(0)


@njit(cache=True)
def _store_order(first, entry, reason, order, rejection):  # type: ignore[no-untyped-def]
    """Write orders and reasons of a tile; return the number of corrected ones."""
    for x in range(len(order)):
        known = (entry[x] >= i4(4)) & (reason[x] == NOTHING)
        order[x] = first - i4(1) + (entry[x] >> i4(2)) if known else NONE
    for x in range(len(order)):
        contradicts = CONTRADICTS if entry[x] < i4(4) else NOTHING
        rejection[x] = reason[x] if reason[x] != NOTHING else contradicts
    n_corrected = i4(0)
    for x in range(len(order)):
        n_corrected += entry[x] & i4(CORRECTED) if rejection[x] == NOTHING else i4(0)
    return n_corrected


@njit(cache=True)
def _orders(images, numbers, code, maps, row, left, right, work, levels, word, reason, entry):  # type: ignore[no-untyped-def]
    """Write phase in [0, 2 pi), orders and reasons of a tile; return how many are corrected."""
    n = right - left
    _make_positive(n, work)
    if len(code.bits) > 0:
        offset = (code.offset if len(code.offset) > 0 else maps.offset)[row, left:right]
        _threshold(offset, numbers, work, levels[0], levels[1])
        _read_words(images, code, row, left, right, levels[0], levels[1], word)
        _look_up(code.table, work, word, entry)
    else:
        entry[:] = 4  # the first order, all others in one class with it
    rejection = maps.rejection[row, left:right]
    n_corrected = _store_order(
        code.first_order, entry, reason, maps.order[row, left:right], rejection
    )
    _store_phase(work, rejection, maps.phase[row, left:right])
    if len(maps.cells) > 0:
        _contrast(images, code, row, left, right, work)
        _store_cells(code, work, word, reason, entry, maps.cells[row, left:right])
    return n_corrected


@njit(cache=True)
def _copy(source, target):  # type: ignore[no-untyped-def]
    for x in range(len(target)):
        target[x] = source[x]


@njit(cache=True, error_model="numpy")
def _decode_block(images, steps, numbers, code, maps, top, bottom):  # type: ignore[no-untyped-def]
    """Fill some rows of the maps."""
    n_cols = images.shape[2]
    work = np.empty(N_SCRATCH, f4)
    levels = np.empty((3, TILE), images.dtype)
    word, reason = np.empty(TILE, u2), np.empty(TILE, u2)
    entry = np.empty(TILE, i4)
    for row in range(top, bottom):
        n_valid, n_corrected = 0, 0
        for left in range(0, n_cols, TILE):
            right = min(left + TILE, n_cols)
            n = right - left
            tile = slice(left, right)
            _sum_steps(images, steps, row, left, right, work)
            _brightest_step(images, steps.places, row, left, right, levels[2, :n])
            _phase(n, numbers, work)
            n_valid += _judge(levels[2, :n], numbers, work, reason[:n])
            _copy(reason, maps.reason[row, tile])
            _copy(work[MODULATION:], maps.modulation[row, tile])
            _copy(work[SIGMA:], maps.sigma[row, tile])
            _store_offset(numbers.black, work, maps.offset[row, tile])
            _store_phase(work, reason[:n], maps.wrapped[row, tile])
            if len(maps.order) > 0:
                n_corrected += _orders(
                    images, numbers, code, maps, row, left, right, work,
                    levels[:, :n], word[:n], reason[:n], entry[:n],
                )  # fmt: skip
        maps.counts[row, 0], maps.counts[row, 1] = n_valid, n_corrected


@njit(cache=True, parallel=True)
def decode_rows(images, steps, numbers, code, maps):  # type: ignore[no-untyped-def]
    """Fill the maps from the images (pattern, row, col), uint8 or uint16."""
    n_rows = images.shape[1]
    for block in prange((n_rows + ROWS_AT_ONCE - 1) // ROWS_AT_ONCE):
        top = np.int64(block) * ROWS_AT_ONCE
        bottom = min(top + ROWS_AT_ONCE, n_rows)
        _decode_block(images, steps, numbers, code, maps, top, bottom)
