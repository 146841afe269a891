"""Union of nodes that edges join, compiled."""

from __future__ import annotations

from numba import njit


@njit(cache=True)
def _first(parent, node):  # type: ignore[no-untyped-def]
    """Return the first node of a part, and shorten the way to it."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True)
def join(start, end, label):  # type: ignore[no-untyped-def]
    """Write the number of each node's connected part (n,), in the order of their first nodes."""
    for node in range(len(label)):
        label[node] = node
    for k in range(len(start)):
        one, other = _first(label, start[k]), _first(label, end[k])
        label[max(one, other)] = min(one, other)
    n_parts = 0
    for node in range(len(label)):
        if label[node] == node:
            label[node] = n_parts
            n_parts += 1
        else:
            label[node] = label[label[node]]  # it comes before, and has its number by now
