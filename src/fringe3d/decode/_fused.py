"""From grey values to phase, modulation, fringe order and reasons in one pass, compiled.

Pixels are worked on in tiles that stay in the processor's first cache: every image byte comes from
memory once, every result goes there once, past the caches. The inner loops run over the pixels of a
tile without a branch and in 32 bits, so that they become vector instructions, and are short, so
that the processor works on several turns at once; all images of one pixel after the other are
slower than NumPy. `wrapped_phase` and `order_from_code` with ``plain=True`` say the same in words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fringe3d.decode._stream import PLAIN_MEMORY, finish_stores, stream
from fringe3d.model import NO_ORDER, Rejection

f4, i4, u2 = np.float32, np.int32, np.uint16

TILE = 1024
"""Pixels at once: their scratch stays in the first two caches, and each image is read in stretches
long enough to be foreseen."""

TOGETHER = 4
"""Images that one sweep adds up; lists of steps are filled up to it with weights of zero."""

PHASE_BINS = 16
"""Parts of a period in which the code is looked up; a cell of half a period holds eight."""

CORRECTED, UNSAFE, CLEAR = 1, 2, 4
"""Lowest bits of an entry of the table: the word alone means another order; it has an
alternative. Above two bits: 0 for no order, else 1 + its place. CLEAR only in `Maps.cells`."""

# Parts of the scratch of a tile, float32: A, first as recorded and then above black; C, then B;
# S, then the phase; reasons; threshold and contrast of the code. Distances are no multiple of 4
# KiB, or else the processor takes what is read from one part for what was just written to another.
PART = TILE + 208
OFFSET, MODULATION, PHASE, REASON, THRESHOLD, CONTRAST = range(0, 6 * PART, PART)
COSINE, SINE = MODULATION, PHASE
N_SCRATCH = 6 * PART

PI, HALF_PI, TWO_PI = f4(np.pi), f4(np.pi / 2), f4(2 * np.pi)
BINS_PER_RAD, LAST_BIN = f4(PHASE_BINS / (2 * np.pi)), i4(PHASE_BINS - 1)
EDGE = f4(1e-4)
"""Bins; whole grey values often give phases between two bins, and rounding must not decide then."""

ZERO, HALF, TINY, NAN, FAR = f4(0), f4(0.5), f4(1e-30), f4(np.nan), f4(np.inf)

A1, A3, A5, A7 = f4(0.9999993443), f4(-0.3332985938), f4(0.1994656622), f4(-0.1390862912)
A9, A11, A13, A15 = f4(0.0964219570), f4(-0.0559123009), f4(0.0218629390), f4(-0.0040545622)
"""Odd polynomial of least largest error, 3.8e-8 rad, for the arctangent of 0..1."""

NOTHING, NONE = u2(0), i4(NO_ORDER)
CONTRADICTS = u2(Rejection.INCONSISTENT_CODE)
# As numbers, for the processor computes with those beside the phase.
SATURATED, LOW = f4(Rejection.SATURATED), f4(Rejection.LOW_MODULATION)
CONTRADICTION = f4(Rejection.INCONSISTENT_CODE)

FLAGS = {"contract", "nsz"}  # multiply and add in one step; NaN and infinity stay what they are

PART_OF_PASS = {**PLAIN_MEMORY, "error_model": "numpy"}
NUMBERS = {**PART_OF_PASS, "fastmath": FLAGS}


class Steps(NamedTuple):
    """Fringe images: places in the stack, and (3, n) weights of A, C and S; n a multiple of 4.

    `ripple` is added to the phase: at evenly spread phases from 0 to 2 pi; (0,) for nothing.
    """

    places: NDArray[np.int64]
    weights: NDArray[np.float32]
    ripple: NDArray[np.float32]


class Numbers(NamedTuple):
    """Limits, DN: B is at least `lowest`, and ``B**2 > least_power + power_gain * max(A, 0)``.

    Phases are negative below zero where `full_turn` is 0, or else moved up by it.
    """

    black: np.float32
    saturation: np.float32
    lowest: np.float32
    least_power: np.float32
    power_gain: np.float32
    full_scale: np.float32
    full_turn: np.float32


class Code(NamedTuple):
    """Gray code: places of bits and inverses (-1: none), packed table, first order.

    `offset` (pixel,) is the light that bits are compared with, (0,) for that of the steps.
    """

    bits: NDArray[np.int64]
    inverses: NDArray[np.int64]
    table: NDArray[np.int32]
    first_order: np.int32
    clear_part: np.float32
    offset: NDArray[np.float32]


class Maps(NamedTuple):
    """Results, all (row, col), or (pixel,) as the pass sees them.

    `order` is empty where there is no code, `cells` unless the table has alternatives: entry of
    the table, shifted by 3, with `UNSAFE` and `CLEAR`.
    """

    offset: NDArray[np.float32]
    modulation: NDArray[np.float32]
    phase: NDArray[np.float32]
    rejection: NDArray[np.uint16]
    order: NDArray[np.int32]
    cells: NDArray[np.int32]


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def arctangent(y, x, full_turn):  # type: ignore[no-untyped-def]
    """Return atan2(y, x) of single-precision numbers within 4e-7 rad.

    In (-pi, pi] where `full_turn` is 0, in [0, 2 pi) where it is 2 pi.
    """
    long, short = max(abs(x), abs(y)), min(abs(x), abs(y))
    t = short / max(long, TINY)
    s = t * t
    ss = s * s
    # In pairs, which do not wait for each other.
    low, high = (A1 + s * A3) + ss * (A5 + s * A7), (A9 + s * A11) + ss * (A13 + s * A15)
    angle = t * (low + ss * ss * high)
    angle = HALF_PI - angle if abs(y) > abs(x) else angle
    angle = PI - angle if x < ZERO else angle
    angle = full_turn - angle if y < ZERO else angle
    return angle if angle < TWO_PI else ZERO


@njit(**NUMBERS)
def _add_steps(images, steps, group, tile, brightest, work):  # type: ignore[no-untyped-def]
    """Add four images of a tile to A, C and S, and to the largest grey values."""
    p0, p1 = steps.places[group], steps.places[group + 1]
    p2, p3 = steps.places[group + 2], steps.places[group + 3]
    im0, im1, im2, im3 = images[p0, tile], images[p1, tile], images[p2, tile], images[p3, tile]
    (a0, c0, s0), (a1, c1, s1) = _weights(steps, group), _weights(steps, group + 1)
    (a2, c2, s2), (a3, c3, s3) = _weights(steps, group + 2), _weights(steps, group + 3)
    for x in range(len(brightest)):
        v0, v1, v2, v3 = f4(im0[x]), f4(im1[x]), f4(im2[x]), f4(im3[x])
        work[OFFSET + x] += a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
        work[COSINE + x] += c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3
        work[SINE + x] += s0 * v0 + s1 * v1 + s2 * v2 + s3 * v3
    for x in range(len(brightest)):
        pair = max(max(im0[x], im1[x]), max(im2[x], im3[x]))
        brightest[x] = max(brightest[x], pair)


@njit(**PART_OF_PASS)
def _weights(steps, step):  # type: ignore[no-untyped-def]
    return steps.weights[0, step], steps.weights[1, step], steps.weights[2, step]


@njit(**NUMBERS)
def _fit(numbers, brightest, work):  # type: ignore[no-untyped-def]
    """Turn A, C and S of a tile into A above black, B, phase and reasons."""
    black, saturation, full_turn = numbers.black, numbers.saturation, numbers.full_turn
    lowest, least_power, power_gain = numbers.lowest, numbers.least_power, numbers.power_gain
    for x in range(len(brightest)):
        cosine, sine = work[COSINE + x], work[SINE + x]
        offset = work[OFFSET + x] - black
        power = cosine * cosine + sine * sine
        modulation = np.sqrt(power)
        good = (modulation >= lowest) & (power > least_power + power_gain * max(offset, ZERO))
        reason = SATURATED if f4(brightest[x]) >= saturation else ZERO
        work[OFFSET + x] = offset
        work[MODULATION + x] = modulation
        work[PHASE + x] = arctangent(sine, cosine, full_turn)
        work[REASON + x] = reason if good else reason + LOW


@njit(**NUMBERS)
def _straighten(ripple, full_turn, n, work):  # type: ignore[no-untyped-def]
    """Take the ripple of a nonlinear response out of the phases of a tile."""
    per_rad, last = f4(len(ripple) - 1) / TWO_PI, i4(len(ripple) - 2)
    lowest = ZERO if full_turn > ZERO else -PI
    for x in range(n):
        phase = work[PHASE + x]
        place = (phase if phase >= ZERO else phase + TWO_PI) * per_rad
        left = min(i4(place), last)
        part = place - f4(left)
        phase += ripple[left] + part * (ripple[left + 1] - ripple[left])
        phase = phase + TWO_PI if phase < lowest else phase
        phase = phase - TWO_PI if phase >= lowest + TWO_PI else phase
        work[PHASE + x] = max(phase, lowest)


@njit(**PART_OF_PASS)
def _reject(work, rejection):  # type: ignore[no-untyped-def]
    """Write the reasons of a tile, and take the phase away where there is one."""
    for x in range(len(rejection)):  # a sum, for choosing what to write is slow
        work[PHASE + x] += ZERO if work[REASON + x] == ZERO else NAN
    for x in range(len(rejection)):
        rejection[x] = i4(work[REASON + x])


@njit(**PART_OF_PASS)
def _threshold(offset, numbers, work, below):  # type: ignore[no-untyped-def]
    """Write the threshold of the code, and the whole grey value below it."""
    black, full_scale = numbers.black, numbers.full_scale
    for x in range(len(below)):
        work[THRESHOLD + x] = min(max(offset[x] + black, ZERO), full_scale)
    for x in range(len(below)):
        below[x] = i4(work[THRESHOLD + x])


@njit(**PART_OF_PASS)
def _above(work, above):  # type: ignore[no-untyped-def]
    """Write the whole grey value above the threshold of the code."""
    for x in range(len(above)):
        above[x] = i4(np.ceil(work[THRESHOLD + x]))


@njit(**PART_OF_PASS)
def _append_bit(bright, dark, word):  # type: ignore[no-untyped-def]
    for x in range(len(word)):
        word[x] = (word[x] << u2(1)) | u2(bright[x] > dark[x])


@njit(**PART_OF_PASS)
def _read_words(images, code, tile, work, below, above, word):  # type: ignore[no-untyped-def]
    """Write the code words of a tile; see `gray.code_words`.

    Grey values are whole: they compare with the rounded threshold as with itself.
    """
    word[:] = NOTHING
    for b in range(len(code.bits)):
        bit, inverse = images[code.bits[b], tile], images[code.inverses[b], tile]
        if code.inverses[b] < 0:
            _append_bit(bit, below, word)
        elif code.bits[b] < 0:
            _above(work, above)
            _append_bit(above, inverse, word)
        else:
            _append_bit(bit, inverse, word)


@njit(**PART_OF_PASS)
def _contrast(images, code, tile, work):  # type: ignore[no-untyped-def]
    """Write the smallest distance of a bit from its threshold."""
    n = tile.stop - tile.start
    work[CONTRAST : CONTRAST + n] = FAR
    for b in range(len(code.bits)):
        bit, inverse = images[code.bits[b], tile], images[code.inverses[b], tile]
        if code.bits[b] >= 0 and code.inverses[b] >= 0:
            for x in range(n):
                distance = abs(f4(bit[x]) - f4(inverse[x])) * HALF
                work[CONTRAST + x] = min(work[CONTRAST + x], distance)
        else:
            image = bit if code.bits[b] >= 0 else inverse
            for x in range(n):
                distance = abs(f4(image[x]) - work[THRESHOLD + x])
                work[CONTRAST + x] = min(work[CONTRAST + x], distance)


@njit(**PART_OF_PASS)
def _look_up(table, work, word, entry):  # type: ignore[no-untyped-def]
    """Write the entries of the table for the words and phases of a tile."""
    for x in range(len(word)):
        part = min(i4(work[PHASE + x] * BINS_PER_RAD + EDGE), LAST_BIN)
        entry[x] = i4(word[x]) * i4(PHASE_BINS) + part
    for x in range(len(word)):
        entry[x] = table[entry[x]]


@njit(**PART_OF_PASS)
def _mark_cells(code, work, word, entry, cells):  # type: ignore[no-untyped-def]
    """Write what `mend_rows` asks for; 0 where the pixel is rejected."""
    for x in range(len(word)):
        part = min(i4(work[PHASE + x] * BINS_PER_RAD + EDGE), LAST_BIN)
        clear = work[CONTRAST + x] >= code.clear_part * work[MODULATION + x]
        bits = (entry[x] & i4(UNSAFE)) | (i4(CLEAR) if clear else i4(0))
        place = (i4(word[x]) * i4(PHASE_BINS) + part) * i4(8)
        cells[x] = place | bits if work[REASON + x] == ZERO else i4(0)


@njit(**PART_OF_PASS)
def _number(first, work, entry):  # type: ignore[no-untyped-def]
    """Turn entries of the table into orders, and add reasons; return how many are corrected."""
    for x in range(len(entry)):
        contradiction = CONTRADICTION if entry[x] < i4(4) else ZERO
        work[REASON + x] += contradiction if work[REASON + x] == ZERO else ZERO
    n_corrected = i4(0)
    for x in range(len(entry)):
        corrected = entry[x] & i4(CORRECTED)
        n_corrected = i4(n_corrected + (corrected if work[REASON + x] == ZERO else i4(0)))
    for x in range(len(entry)):
        order = i4(first - i4(1) + (entry[x] >> i4(2)))
        entry[x] = order if work[REASON + x] == ZERO else NONE
    return n_corrected


@njit(**PART_OF_PASS)
def _orders(images, numbers, code, maps, tile, work, levels, word, entry):  # type: ignore[no-untyped-def]
    """Write the orders of a tile and its cells, add reasons; return how many are corrected."""
    offset = code.offset[tile] if len(code.offset) > 0 else work[OFFSET : OFFSET + len(word)]
    _threshold(offset, numbers, work, levels[0])
    _read_words(images, code, tile, work, levels[0], levels[1], word)
    _look_up(code.table, work, word, entry)
    if len(maps.cells) > 0:
        _contrast(images, code, tile, work)
        _mark_cells(code, work, word, entry, maps.cells[tile])
    n_corrected = _number(code.first_order, work, entry)
    stream(entry, maps.order[tile])
    return n_corrected


@njit(**PART_OF_PASS)
def _decode_tiles(images, steps, numbers, code, maps, n_corrected, first, last, scratch):  # type: ignore[no-untyped-def]
    """Fill some tiles of the maps."""
    work, levels, word, reason, entry = scratch
    for number in range(first, last):
        tile = slice(number * TILE, min((number + 1) * TILE, images.shape[1]))
        n = tile.stop - tile.start
        work[: 3 * PART] = ZERO
        levels[2] = 0
        for group in range(0, len(steps.places), TOGETHER):
            _add_steps(images, steps, group, tile, levels[2, :n], work)
        _fit(numbers, levels[2, :n], work)
        if len(steps.ripple) > 0:
            _straighten(steps.ripple, numbers.full_turn, n, work)
        if len(maps.order) > 0:
            n_corrected[number] = _orders(
                images, numbers, code, maps, tile, work, levels[:, :n], word[:n], entry[:n]
            )
        _reject(work, reason[:n])
        stream(work[OFFSET:], maps.offset[tile])
        stream(work[MODULATION:], maps.modulation[tile])
        stream(work[PHASE:], maps.phase[tile])
        stream(reason, maps.rejection[tile])
    finish_stores()  # type: ignore[call-arg]


@njit(cache=True, nogil=True)
def decode_pixels(images, steps, numbers, code, maps, n_corrected, tiles):  # type: ignore[no-untyped-def]
    """Fill the maps from the images (pattern, pixel), uint8 or uint16.

    `n_corrected` (tile,) are orders that the word alone would not give; tiles: first and last but
    one of those to go through.
    """
    scratch = (
        np.empty(N_SCRATCH, f4), np.empty((3, TILE), images.dtype),
        np.empty(TILE, u2), np.empty(TILE, u2), np.empty(TILE, i4),
    )  # fmt: skip
    _decode_tiles(images, steps, numbers, code, maps, n_corrected, tiles[0], tiles[1], scratch)
