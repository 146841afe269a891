"""Semi-global aggregation of evidence for fringe orders, compiled.

After H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information" (2008),
with fringe orders in place of disparities: what moves freely is the *absolute* phase.

Costs are whole numbers: sums do not depend on their order, nor on the number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fringe3d.correspond._lanes import LANES, carry
from fringe3d.kernels import over_rows

TWO_PI = 2.0 * math.pi
TURNS_PER_RAD = np.float32(1 / TWO_PI)

STEP_PENALTY, JUMP_PENALTY = 5.0, 14.0
"""For one order between neighbours, and for any other number. Too weak ones cost most: the second
should be ten times the largest cost of a pixel."""

BEND_RAD = 0.3
"""Second difference of the phase between neighbours at which a depth edge becomes likely."""

LEAST_PENALTY = 0.05
"""Part of the penalty that is left on an edge."""

UNIT = 256
"""Costs are counted in parts of a half squared deviation. Eight paths of at most the largest cost
of a pixel, 7.2, and the penalty of a jump each: their sum stays below 2**16."""

FAR = np.uint16(20_000)
"""Cost of a label that no order stands for; more than any path's."""

FAR_ENERGY = np.uint16(2**16 - 1)

MOST_APART = 40
"""Half squared deviations; what is worse by more has no weight."""

WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""(rows, columns) from a pixel to its neighbour; four more lead back."""

N_PATHS = 2 * len(WAYS)

U16 = np.uint16


@njit(cache=True, error_model="numpy")
def _wrapped(angle):  # type: ignore[no-untyped-def]
    return angle - TWO_PI * math.floor(angle / TWO_PI + 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def write_jumps(phase, index, jumps, rows):  # type: ignore[no-untyped-def]
    """Write the price of a jump next to each pixel, (n, 4) for `WAYS`: less where the phase bends.

    phase (row, col): rad; index (row, col): number of the pixel, -1 for none; rows: first and last
    but one.
    """
    n_rows, n_cols = phase.shape
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            i = index[row, col]
            if i < 0:
                continue
            for way in range(4):
                dy, dx = WAYS[way]
                weight = 1.0
                inside = row - dy >= 0 and row + dy < n_rows
                inside &= min(col - dx, col + dx) >= 0 and max(col - dx, col + dx) < n_cols
                if inside and index[row - dy, col - dx] >= 0 and index[row + dy, col + dx] >= 0:
                    rise = _wrapped(phase[row + dy, col + dx] - phase[row, col])
                    bend = rise - _wrapped(phase[row, col] - phase[row - dy, col - dx])
                    weight = math.exp(-((bend / BEND_RAD) ** 2))
                jumps[i, way] = U16(UNIT * JUMP_PENALTY * max(weight, LEAST_PENALTY) + 0.5)


@njit(cache=True, error_model="numpy")
def _place(gap, label_step, n_labels, middle, nowhere):  # type: ignore[no-untyped-def]
    """Return where the labels stand that are `gap` orders further on."""
    shift = gap
    if label_step > 1:
        shift = gap // label_step
        if shift * label_step != gap:
            return nowhere
    if abs(shift) >= n_labels:
        return nowhere
    return middle + shift


@njit(cache=True, error_model="numpy")
def _sweep(sign, phase, index, first, label_step, jumps, costs, total):  # type: ignore[no-untyped-def]
    """Follow four paths through the image, down (sign 1) or up (-1), and add up what they carry."""
    n_rows, n_cols = phase.shape
    n_labels = costs.shape[1]
    width = 2 * n_labels  # the labels of each pixel, and no orders between them and the next
    paths = np.full(2 * 4 * n_cols * width + 2 * n_labels, FAR, np.uint16)
    leasts = np.zeros((2, 4, n_cols), np.uint16)
    flat_costs, flat_total = costs.reshape(-1), total.reshape(-1)
    for line in range(n_rows):
        row = line if sign > 0 else n_rows - 1 - line
        for along in range(n_cols):
            col = along if sign > 0 else n_cols - 1 - along
            i = index[row, col]
            if i < 0:
                continue
            for way in range(4):
                dy, dx = WAYS[way]
                y, x = row - sign * dy, col - sign * dx
                j = index[y, x] if 0 <= y < n_rows and 0 <= x < n_cols else -1
                parity = (line - dy) % 2
                if j >= 0 and leasts[parity, way, x] >= FAR:
                    j = -1  # it has no order at all: the path starts anew
                to = ((line % 2) * 4 + way) * n_cols + col
                same, above, below = 0, 0, 0
                jump, step, least = U16(0), U16(0), U16(0)
                if j >= 0:
                    turns = np.rint((phase[row, col] - phase[y, x]) * TURNS_PER_RAD)
                    gap = first[i] + int(turns) - first[j]
                    middle = ((parity * 4 + way) * n_cols + x) * width + n_labels
                    same = _place(gap, label_step, n_labels, middle, 0)
                    above = _place(gap + 1, label_step, n_labels, middle, 0)
                    below = _place(gap - 1, label_step, n_labels, middle, 0)
                    least = leasts[parity, way, x]
                    step = U16(jumps[j, way] * (STEP_PENALTY / JUMP_PENALTY) + 0.5)
                    jump = U16(least + jumps[j, way])
                smallest = U16(65535)
                for block in range(0, n_labels, LANES):
                    smallest = min(smallest, carry(  # type: ignore[call-arg]
                        paths, same + block, above + block, below + block, flat_costs, flat_total,
                        i * n_labels + block, to * width + n_labels + block, step, jump, least,
                    ))  # fmt: skip
                leasts[line % 2, way, col] = smallest


@njit(cache=True, nogil=True, error_model="numpy")
def _sweeps(phase, index, first, label_step, jumps, costs, totals, numbers):  # type: ignore[no-untyped-def]
    for number in range(numbers[0], numbers[1]):
        _sweep(1 - 2 * number, phase, index, first, label_step, jumps, costs, totals[number])


@njit(cache=True, nogil=True, error_model="numpy")
def _sum(totals, costs, energy, rows):  # type: ignore[no-untyped-def]
    """Write the sum of all paths, each pixel's own cost counted once; `FAR_ENERGY` for no order."""
    for i in range(rows[0], rows[1]):
        for a in range(energy.shape[1]):
            own = costs[i, a]
            known = own < FAR
            rest = U16(totals[0, i, a] + totals[1, i, a] - (N_PATHS - 1) * own)
            energy[i, a] = rest if known else FAR_ENERGY


@njit(cache=True, nogil=True, error_model="numpy")
def write_own_costs(costs, extras, is_label, largest, own, rows):  # type: ignore[no-untyped-def]
    """Write what each pixel alone has against its labels, in parts of `UNIT`, (n, padded(m)).

    costs, extras (n, m): squared deviations in C2, NaN where it sees nothing, and of all else;
    largest: of each and of both, and the price of what C2 does not see, half squared deviations.
    """
    most, most_extra, most_in_all, hidden = largest
    for i in range(rows[0], rows[1]):
        own[i] = FAR
        for a in range(costs.shape[1]):
            if is_label[i, a]:
                cost = hidden if math.isnan(costs[i, a]) else min(costs[i, a] / 2, most)
                cost = min(cost + min(extras[i, a] / 2, most_extra), most_in_all)
                own[i, a] = U16(min(UNIT * cost + 0.5, FAR - 1))


@njit(cache=True, nogil=True, error_model="numpy")
def choose(energy, is_label, is_inside, outside_cost, place, probability, outside, rows):  # type: ignore[no-untyped-def]
    """Write the label of least energy, its probability, and that of all labels outside, (n,).

    energy (n, >= m): in parts of `UNIT`; outside_cost: what speaks against a label outside the
    volume; is_label, is_inside (n, m). NaN where there is no label.
    """
    for i in range(rows[0], rows[1]):
        best, least = 0, 1e9
        for a in range(is_inside.shape[1]):
            value = energy[i, a] + (0 if is_inside[i, a] else outside_cost)
            if is_label[i, a] and value < least:
                best, least = a, value
        total, beyond = 0.0, 0.0
        for a in range(is_inside.shape[1]):
            if not is_label[i, a]:
                continue
            value = energy[i, a] + (0 if is_inside[i, a] else outside_cost)
            if value - least < MOST_APART * UNIT:
                weight = math.exp((least - value) / UNIT)
                total += weight
                beyond += 0.0 if is_inside[i, a] else weight
        place[i] = best
        probability[i] = 1 / total if total > 0 else np.nan
        outside[i] = beyond / total if total > 0 else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def choose_from_paths(totals, own, found, label_step, inside, outside_cost, chosen, rows):  # type: ignore[no-untyped-def]
    """Do what `choose` does for orders that stand in a row, from the sums of both sweeps.

    totals (2, n, m), own (n, m): see `aggregate`, totals (0, 0, 0) where nothing is aggregated;
    found, inside (n, 2): lowest and highest order of the pixel, and inside the volume; label_step:
    their distance. chosen = (place, probability, outside), (n,), written.
    """
    place, probability, outside = chosen
    together, more = totals.shape[0] > 0, np.int64(outside_cost)
    values = np.empty(own.shape[1], np.int64)
    for i in range(rows[0], rows[1]):
        count = min((found[i, 1] - found[i, 0]) // label_step + 1, own.shape[1])
        best, least = 0, 1_000_000_000
        for a in range(count):
            order = found[i, 0] + a * label_step
            cost = own[i, a]
            value = np.int64(cost)
            if together:
                value = np.int64(U16(totals[0, i, a] + totals[1, i, a] - (N_PATHS - 1) * cost))
            value += 0 if inside[i, 0] <= order <= inside[i, 1] else more
            values[a] = value if cost < FAR else 1_000_000_000
            if values[a] < least:
                best, least = a, values[a]
        total, beyond = 0.0, 0.0
        for a in range(count):
            if values[a] - least < MOST_APART * UNIT:
                weight = math.exp((least - values[a]) / UNIT) if values[a] > least else 1.0
                total += weight
                order = found[i, 0] + a * label_step
                beyond += 0.0 if inside[i, 0] <= order <= inside[i, 1] else weight
        known = least < 1_000_000_000
        place[i] = best
        probability[i] = 1 / total if known else np.nan
        outside[i] = beyond / total if known else np.nan


def padded(n_labels: int, /) -> int:
    """Return the number of labels that kernels take: a multiple of the vector's length."""
    return -(-n_labels // LANES) * LANES


def aggregate(
    phase: NDArray[np.float32],
    index: NDArray[np.int32],
    first: NDArray[np.int32],
    label_step: int,
    costs: NDArray[np.uint16],
    jumps: NDArray[np.uint16] | None = None,
    /,
) -> NDArray[np.uint16]:
    """Return the evidence against each candidate, (n, m), all pixels of the image considered.

    phase (row, col): rad; index (row, col): number of the pixel in the lists, -1 for none; label a
    of pixel i stands for the order ``first[i] + a * label_step``; costs (n, m), in parts of `UNIT`:
    its own, `FAR` for none, m a multiple of `LANES`; jumps: as `write_jumps` writes them.

    The sum of the eight path costs counts the pixel's own cost eight times; all but one are taken
    off, which makes it the least cost of any assignment along the paths that has this order.
    """
    if jumps is None:
        jumps = np.empty((len(costs), len(WAYS)), np.uint16)
        over_rows(write_jumps, len(phase), phase, index, jumps)
    totals = paths(phase, index, first, label_step, costs, jumps)
    energy = np.empty_like(costs)
    over_rows(_sum, len(energy), totals, costs, energy)
    return energy


def paths(
    phase: NDArray[np.float32],
    index: NDArray[np.int32],
    first: NDArray[np.int32],
    label_step: int,
    costs: NDArray[np.uint16],
    jumps: NDArray[np.uint16],
    /,
) -> NDArray[np.uint16]:
    """Return the sums of the four paths down and of the four up, (2, n, m); see `aggregate`."""
    totals = np.zeros((2, *costs.shape), np.uint16)
    over_rows(_sweeps, 2, phase, index, first, label_step, jumps, costs, totals, least=1)
    return totals
