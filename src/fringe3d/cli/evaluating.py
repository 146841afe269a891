"""``fringe3d evaluate acceptance`` and ``compare``: judge clouds, whoever measured them."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, at_least, simulator_installed
from fringe3d.cli.simulated import evaluate
from fringe3d.errors import Fringe3DError, MethodError

if TYPE_CHECKING:
    from fringe3d.evaluate import Deviations, Probed
    from fringe3d.io.clouds import CloudFile
    from fringe3d.report.acceptance import Position

MESH_SUFFIXES = (".stl", ".obj")
REACH_OF_GAP = 20.0
"""Deviations are sought up to twenty typical distances of points, where nothing else is asked."""

GAP_SAMPLE = 2000


@evaluate.command
def acceptance(
    *,
    ball: list[Path] | None = None,
    ball_bar: list[Path] | None = None,
    plane: list[Path] | None = None,
    diameter: Annotated[float | None, Parameter(validator=at_least(1e-6))] = None,
    distance: Annotated[float | None, Parameter(validator=at_least(1e-6))] = None,
    max_form: Annotated[float | None, Parameter(validator=at_least(0))] = None,
    max_size: Annotated[float | None, Parameter(validator=at_least(0))] = None,
    max_spacing: Annotated[float | None, Parameter(validator=at_least(0))] = None,
    max_flatness: Annotated[float | None, Parameter(validator=at_least(0))] = None,
    uncertainty: Annotated[float, Parameter(validator=at_least(0))] = 0.0,
    cap: Annotated[float, Parameter(validator=at_least(1, 180))] = 60.0,
    margin: Annotated[float, Parameter(validator=at_least(0))] = 2.0,
    out: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Judge a measuring system by artefacts, after VDI/VDE 2634 part 2 (and 3 for merged clouds).

    Measure each artefact at several places of the volume and name all results: folders that
    fringe3d measure left, or clouds of any program (PLY, XYZ, NPZ). Artefacts are found in them.
    Leaves acceptance.md, acceptance.json and overview.png in OUT. Exit code 1 if a limit is broken.
    Example: fringe3d evaluate acceptance --ball r1 --ball r2 --ball-bar r3 --plane r4
    --diameter 20.003 --distance 60.012 --max-form 0.03 --uncertainty 0.001 --out accepted

    Parameters
    ----------
    ball
        A result that shows a ball: probing error, form and size; repeat it.
    ball_bar
        A result that shows two balls: error of sphere spacing; repeat it.
    plane
        A result that shows a plane: flatness; repeat it.
    diameter
        Calibrated diameter of all balls, mm.
    distance
        Calibrated distance of the centres of the ball bar, mm.
    max_form, max_size, max_spacing, max_flatness
        Limits, mm; without one, values are reported and not judged.
    uncertainty
        Expanded uncertainty (k = 2) of the artefacts' calibration, mm: a value passes only if it
        keeps its limit with all of it (ISO 14253-1).
    cap
        Part of a ball that is fitted: half its opening seen from the centre, degrees; 180 takes
        all of a ball merged from several views.
    margin
        Points nearer to the border of the plane are left out, mm.
    out
        Folder for report and picture; must not exist yet.
    """
    from fringe3d.io.atomic import require_writable
    from fringe3d.report.acceptance import (
        Limits,
        acceptance_markdown,
        acceptance_record,
        acceptance_text,
        write_acceptance,
    )

    named = [*(ball or ()), *(ball_bar or ()), *(plane or ())]
    _require_artefacts(named, ball, ball_bar, diameter, distance)
    if out is not None:
        require_writable(out, overwrite=overwrite, inputs=named)
    limits = Limits(form_mm=max_form, size_mm=max_size, spacing_mm=max_spacing,
                    flatness_mm=max_flatness, uncertainty_mm=uncertainty)  # fmt: skip
    positions: list[Position] = []
    with Reporter(quiet=as_json).running() as reporter:
        for paths, kind in ((ball, "ball"), (ball_bar, "ball bar"), (plane, "plane")):
            for path in paths or ():
                reporter.step("fitting", len(positions), len(named))
                positions.append(_position(path, kind, diameter, distance, cap, margin))
    record = acceptance_record(positions, limits, cap_deg=cap, margin_mm=margin)
    if out is not None:
        command = shlex.join(["fringe3d", *sys.argv[1:]])
        text = acceptance_markdown(record, command=command)
        write_acceptance(out, positions, record, text, overwrite=overwrite)
    place = f"\n-> {out}" if out is not None else ""
    say(acceptance_text(record) + place, record, as_json=as_json)
    if record["decision"] == "fail":
        sys.exit(1)


def _require_artefacts(
    named: list[Path],
    ball: list[Path] | None,
    ball_bar: list[Path] | None,
    diameter: float | None,
    distance: float | None,
) -> None:
    if not named:
        raise MethodError(
            "evaluate acceptance: expected results of artefacts, found none. Name them: --ball, "
            "--ball-bar, --plane"
        )
    if (ball or ball_bar) and diameter is None:
        raise MethodError(
            "--diameter: expected the calibrated diameter of the balls, mm, found none. Give it"
        )
    if ball_bar and distance is None:
        raise MethodError(
            "--distance: expected the calibrated distance of the ball bar's centres, mm, found "
            "none. Give it"
        )


def _position(
    path: Path,
    kind: str,
    diameter: float | None,
    distance: float | None,
    cap_deg: float,
    margin_mm: float,
) -> Position:
    """Read a result and fit what it shows."""
    from fringe3d.evaluate import probe_plane, probe_spheres
    from fringe3d.io.clouds import read_cloud
    from fringe3d.report.acceptance import Position

    cloud = read_cloud(path)
    probed: tuple[Probed, ...]
    try:
        if kind == "plane":
            probed = (probe_plane(cloud.points_mm, margin_mm=margin_mm),)
        else:
            assert diameter is not None
            n = 2 if kind == "ball bar" else 1
            probed = probe_spheres(cloud.points_mm, diameter, n, cap_deg=cap_deg)
    except Fringe3DError as problem:
        raise type(problem)(f"{path}: {problem}") from None
    return Position(name=str(path), kind=kind, cloud=cloud, probed=probed, diameter_mm=diameter,
                    distance_mm=distance)  # fmt: skip


@evaluate.command
def compare(
    cloud: Path,
    reference: Path,
    /,
    *,
    tolerance: Annotated[float | None, Parameter(validator=at_least(0))] = None,
    reach: Annotated[float | None, Parameter(validator=at_least(1e-9))] = None,
    viewpoint: str | None = None,
    mesh: Annotated[bool, Parameter(negative=())] = False,
    out: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compare a cloud with another one, or with a mesh: signed deviations, a map of them.

    Both must lie in one frame. Deviations are square to the reference, positive in front of it.
    Leaves compare.md, compare.json, overview.png and deviations.ply (coloured) in OUT.
    Example: fringe3d evaluate compare result rival.ply --out compared

    Parameters
    ----------
    cloud
        What is judged: a result folder, or a cloud of any program (PLY, XYZ, NPZ), mm.
    reference
        Another cloud, or a mesh (STL, OBJ, or PLY with --mesh), mm.
    tolerance
        Also tell which part of the points lies within so many mm.
    reach
        Points farther from the reference are counted, not compared, mm; by default twenty typical
        distances of neighbouring points.
    viewpoint
        X,Y,Z, mm: what lies nearer to it is in front; by default from where the result was seen,
        else the origin. A mesh has an outside.
    mesh
        The reference is a mesh, although it is a PLY file.
    out
        Folder for report and pictures; must not exist yet.
    """
    from fringe3d.io.atomic import require_writable
    from fringe3d.io.clouds import read_cloud
    from fringe3d.report.deviations import (
        deviation_markdown,
        deviation_record,
        deviation_text,
        write_deviations,
    )

    if out is not None:
        require_writable(out, overwrite=overwrite, inputs=(cloud, reference))
    own = read_cloud(cloud)
    deviations, view = deviations_of(
        own, reference, name=cloud, is_mesh=mesh, reach_mm=reach, viewpoint=viewpoint
    )
    record = deviation_record(deviations, tolerance_mm=tolerance)
    record |= {"cloud": str(cloud), "reference": str(reference)}
    if out is not None:
        command = shlex.join(["fringe3d", *sys.argv[1:]])
        text = deviation_markdown(record, command=command)
        write_deviations(out, own.points_mm, view, deviations, record, text, overwrite=overwrite)
    place = f" -> {out}" if out is not None else ""
    say(deviation_text(record) + place, record, as_json=as_json)


def deviations_of(
    own: CloudFile,
    reference: Path,
    /,
    *,
    name: Path,
    is_mesh: bool = False,
    reach_mm: float | None = None,
    viewpoint: str | None = None,
) -> tuple[Deviations, NDArray[np.float64]]:
    """Return how far points lie from a cloud or mesh, and from where in front of it is told.

    Parameters
    ----------
    own : CloudFile
    reference : Path; of a result, a cloud or a mesh
    name : Path; of the points, for messages
    is_mesh : bool; the reference is a mesh, although it is a PLY file
    reach_mm : float or None; see `compare`
    viewpoint : str or None; see `compare`

    Raises
    ------
    MethodError
        If the reference cannot be read, or nothing of it is near.
    """
    from fringe3d.evaluate import deviations_from_cloud, deviations_from_mesh
    from fringe3d.io.clouds import read_cloud

    view = _viewpoint(viewpoint, own)
    deviations: Deviations
    if is_mesh or reference.suffix.lower() in MESH_SUFFIXES:
        triangles = _triangles(reference)
        deviations = deviations_from_mesh(
            own.points_mm, triangles, reach_mm=reach_mm or _reach(own.points_mm)
        )
    else:
        other = read_cloud(reference)
        if viewpoint is None and own.viewpoint_mm is None:
            view = _viewpoint(None, other)
        deviations = deviations_from_cloud(
            own.points_mm, other.points_mm, reach_mm=reach_mm or _reach(other.points_mm),
            viewpoint_mm=view, normals=other.normals,
        )  # fmt: skip
    if not len(deviations.known):
        raise MethodError(
            f"{name}: expected points within {deviations.reach_mm:.3g} mm of {reference}, found "
            "none. Check that both are in one frame and in mm, or give a larger --reach"
        )
    return deviations, view


def _viewpoint(text: str | None, cloud: CloudFile) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    if text is None:
        return np.zeros(3) if cloud.viewpoint_mm is None else np.asarray(cloud.viewpoint_mm)
    try:
        place = np.array([float(part) for part in text.split(",")])
    except ValueError:
        place = np.empty(0)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise MethodError(f"--viewpoint: expected X,Y,Z in mm, as 0,0,300, found '{text}'")
    return place


def _reach(points: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    """Return twenty typical distances of a point to the nearest other one, mm."""
    from scipy.spatial import cKDTree

    sample = points[:: max(1, len(points) // GAP_SAMPLE)]
    distance, _ = cKDTree(points).query(sample, k=[min(2, len(points))])
    return max(REACH_OF_GAP * float(np.median(distance)), 1e-6)


def _triangles(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    from fringe3d.io.meshes import read_triangles

    with simulator_installed("evaluate compare with a mesh"):
        return read_triangles(path)
