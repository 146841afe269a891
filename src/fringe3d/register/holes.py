"""Holes of a mesh: where they are, and fans that close them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

MOST_ROUNDS = 20


def closed_holes(vertices: Floats, faces: Faces, /) -> tuple[Floats, Faces]:
    """Close every hole by a fan of triangles around the middle of its border.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int; anticlockwise seen from outside

    Returns
    -------
    (n', 3) float, (m', 3) int
        Each edge now belongs to two faces, which go along it in opposite directions. Faces that go
        along an edge in the same direction as another one are taken out first.

    Examples
    --------
    >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    >>> open_ = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2]])
    >>> len(closed_holes(corners, open_)[1])
    6
    """
    faces = _once_along_each_edge(faces)
    loops = border_loops(faces)
    more_vertices, more_faces = [], []
    for number, loop in enumerate(loops):
        middle = len(vertices) + number
        more_vertices.append(vertices[loop].mean(axis=0))
        after = np.roll(loop, -1)
        more_faces.append(np.stack([loop, after, np.full(len(loop), middle)], axis=1))
    if not loops:
        return vertices, faces
    return (
        np.concatenate([vertices, np.array(more_vertices)]),
        np.concatenate([faces, *more_faces]).astype(np.int32),
    )


def _directed(faces: Faces) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the edges of all faces begin and end, (3 m,)."""
    return (faces.T.ravel().astype(np.int64), faces[:, [1, 2, 0]].T.ravel().astype(np.int64))


def _once_along_each_edge(faces: Faces) -> Faces:
    for _ in range(MOST_ROUNDS):
        begin, end = _directed(faces)
        keys = begin * (int(faces.max(initial=0)) + 1) + end
        _, first = np.unique(keys, return_index=True)
        again = np.ones(len(keys), bool)
        again[first] = False
        if not again.any():
            break
        faces = faces[~again.reshape(3, -1).any(axis=0)]
    return faces


def border_loops(faces: Faces, /) -> list[NDArray[np.int64]]:
    """Return the borders of a mesh as rings of vertices, in the direction of the faces missing.

    Parameters
    ----------
    faces : (m, 3) int
    """
    begin, end = _directed(faces)
    size = int(faces.max(initial=0)) + 1
    is_border = ~np.isin(end * size + begin, begin * size + end)
    # A missing face goes along a border the other way round.
    onward: dict[int, list[int]] = {}
    for a, b in zip(end[is_border].tolist(), begin[is_border].tolist(), strict=True):
        onward.setdefault(a, []).append(b)
    loops = []
    while onward:
        start = next(iter(onward))
        path, place = [start], {start: 0}
        while True:
            following = onward[path[-1]]
            step = following.pop()
            if not following:
                del onward[path[-1]]
            if step in place:  # a ring within the way is closed; the way goes on before it
                ring = path[place[step] :]
                loops.append(np.array(ring, np.int64))
                for vertex in ring[1:]:
                    del place[vertex]
                path = path[: place[step] + 1]
                if path[-1] not in onward:
                    break
                continue
            place[step] = len(path)
            path.append(step)
    return loops
