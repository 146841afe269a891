"""Merging against the truth: the table's axis, poses, the merged surface, a view that had moved.

    python benchmarks/merging.py --object machine-part --size 320x256
    python benchmarks/merging.py --scans SCANS --results RESULTS     # simulated and measured before

Simulates 12 positions and 2 tilts on ``kolibri`` (4 steps, M2), measures, registers with known and
unknown angles, fuses, and compares with the exact truth. The last line gives one view the
calibration of a second camera turned by 0.05 degrees.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from fringe3d.cli import main as fringe3d
from fringe3d.cli.measuring_views import Measured, Source, measure_views
from fringe3d.evaluate.deviations import deviations_from_mesh
from fringe3d.io.recording import read_scan
from fringe3d.model import FoundTable, RigidTransform, SurfaceView, TableAxis
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import measure
from fringe3d.register import (
    RegisterOptions,
    fuse,
    odd_views,
    register,
    split_edges,
    surface_view,
    vector_of,
    with_edges,
)
from fringe3d.register.table_model import near_point
from fringe3d.simulate import OBJECTS, PRESETS, knocked

OPTIONS = MeasureOptions()
CELL_MM = 1.0
OUTLIER_MM = 0.06
CREASE = np.radians(20)
BAD = 5


def parsed() -> argparse.Namespace:
    """Return what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--object", default="machine-part", choices=["machine-part", "teeth"])
    parser.add_argument("--size", default="320x256")
    parser.add_argument("--positions", default="12")
    parser.add_argument("--scans", type=Path, default=None)
    parser.add_argument("--results", type=Path, default=None)
    parser.add_argument("--jobs", type=int, default=2)
    return parser.parse_args()


def main() -> None:
    """Simulate, measure, judge."""
    told = parsed()
    with tempfile.TemporaryDirectory() as folder:
        scans = told.scans or Path(folder) / "scans"
        if told.scans is None:
            fringe3d(["simulate", "kolibri", "--object", told.object, "--plan", "m2",
                      "--camera-size", told.size, "--positions", told.positions, "--tilts", "0,30",
                      "--axis-off", "3mm:2deg", "--out", str(scans)])  # fmt: skip
        paths = sorted(p for p in scans.iterdir() if (p / "scan.toml").is_file())
        kept = told.results or Path(folder) / "views"
        kept.mkdir(exist_ok=True)
        began = time.perf_counter()
        sources = [Source(name=path.name, path=path) for path in paths]
        measured = measure_views(sources, OPTIONS, kept, jobs=told.jobs,
                                 finished=lambda *_: None)  # fmt: skip
        print(f"{len(paths)} scans measured in {time.perf_counter() - began:.0f} s")
        judge(paths, measured, told.object)


def judge(paths: list[Path], measured: Measured, thing: str) -> None:
    """Print axis, poses, surface and the view that had moved, against the truth."""
    views = measured.views
    truths = [np.load(path / "truth.npz") for path in paths]
    world_from_object = [_transform(truth["world_from_object"]) for truth in truths]
    true = [world_from_object[0] @ pose.inverse() for pose in world_from_object]
    axis = TableAxis(point_mm=[0, 0, 0], direction=[0, 0, 1])
    if "table_direction" in truths[0]:
        axis = TableAxis(point_mm=truths[0]["table_point_mm"],
                         direction=truths[0]["table_direction"])  # fmt: skip
    for angles in ("known", "rough", "unknown", "free"):
        began = time.perf_counter()
        told = _misread(views) if angles == "rough" else views
        found = register(told, RegisterOptions(angles=angles))  # type: ignore[arg-type]
        seconds = time.perf_counter() - began
        errors = np.array([vector_of(f @ t.inverse(), found.middle_mm)
                           for f, t in zip(found.body_from_view, true, strict=True)])  # fmt: skip
        rms = np.sqrt((errors[1:] ** 2).mean(axis=0))
        print(
            f"angles {angles}: {_axis_words(found.table, axis)}"
            f"poses {1e3 * np.linalg.norm(rms[3:]):.1f} um, "
            f"{1e6 * np.linalg.norm(rms[:3]):.0f} urad, the worst "
            f"{1e3 * np.linalg.norm(errors[:, 3:], axis=1).max():.1f} um; closure "
            f"{1e3 * found.closure_mm:.1f} um; {seconds:.0f} s"
        )
    began = time.perf_counter()
    found = register(views, RegisterOptions(angles="known"))
    cloud = fuse(views, found.body_from_view, noise_factor=found.noise_factor)
    if measured.edges is not None:
        cloud = with_edges(cloud, views, found.body_from_view, measured.edges)
    print(f"fused in {time.perf_counter() - began:.0f} s: {len(cloud.points_mm):,} points; "
          f"{ {f.name: n for f, n in cloud.counts().items()} }")  # fmt: skip
    surface(cloud, views, truths, world_from_object, thing)
    bad_view(paths, views, true)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"peak memory {memory:.1f} GB")


def _misread(views: list[SurfaceView]) -> list[SurfaceView]:
    """Return the views with angles wrong by up to 2 degrees."""
    wrong = np.radians(np.random.default_rng(1).uniform(-2, 2, len(views)))
    return [replace(v, position=replace(v.position, angle=v.position.angle + e))  # type: ignore
            for v, e in zip(views, wrong, strict=True)]  # fmt: skip


def _axis_words(table: FoundTable | None, true: TableAxis) -> str:
    """Say how far the axis lies from the true one."""
    if table is None:
        return ""
    off = near_point(true, table.middle_mm) - table.middle_mm
    lean = np.linalg.norm(np.cross(table.axis.direction, true.direction))
    return (
        f"axis {1e3 * np.linalg.norm(off):.2f} um (sigma {1e3 * table.shift_sigma_mm:.2f}), "
        f"{1e6 * lean:.1f} urad (sigma {1e6 * table.lean_sigma:.1f}); "
    )


def _transform(matrix: np.ndarray) -> RigidTransform:
    return RigidTransform(rotation=matrix[:3, :3], translation=matrix[:3, 3])


def surface(cloud, views, truths, poses, thing: str) -> None:  # type: ignore[no-untyped-def]
    """Compare the merged surface, and the first view, with the true mesh."""
    preset = PRESETS["kolibri"](views[0].camera.shape[::-1])
    mesh = preset.scene(OBJECTS[thing](), background="none").thing
    triangles = mesh.vertices_mm[mesh.faces]
    own = poses[0].inverse()
    merged = deviations_from_mesh(own.apply(cloud.points_mm), triangles, reach_mm=1.0).signed_mm
    first = views[0].points_mm[views[0].is_valid]
    single = deviations_from_mesh(own.apply(first), triangles, reach_mm=1.0).signed_mm
    systematic, noise = cells(cloud, merged)
    print(
        f"deviation from the true surface, um: merged robust sigma {_robust(merged):.1f}, mean "
        f"{1e3 * np.nanmean(merged):+.1f}, sigma {1e3 * np.nanstd(merged):.1f}, 95 % below "
        f"{1e3 * np.nanpercentile(np.abs(merged), 95):.1f}; first view robust "
        f"{_robust(single):.1f}, sigma {1e3 * np.nanstd(single):.1f}, 95 % below "
        f"{1e3 * np.nanpercentile(np.abs(single), 95):.1f}"
    )
    print(f"systematic part (medians of cells of {CELL_MM:g} mm), um: {spread(systematic, noise)}")
    # The first view is the frame, so what it errs moves all: best fit, as against a CAD mesh.
    place, way = own.apply(cloud.points_mm), own.rotate(cloud.normals.astype(float))
    design = np.column_stack([np.cross(place - place.mean(axis=0), way), way])
    near = np.abs(merged) < OUTLIER_MM
    fitted = merged - design @ np.linalg.lstsq(design[near], merged[near])[0]
    print(f"after best fit: {spread(*cells(cloud, fitted))}")
    smooth = _from_creases(mesh, place) > 2 * views[0].spacing_mm
    print(f"beyond two pixels of creases ({smooth.mean():.0%} of the points): "
          f"{spread(*cells(cloud, fitted, smooth))}")  # fmt: skip
    seen = []
    for truth, pose in zip(truths, poses, strict=True):
        good = truth["is_object"] & truth["lit"] & truth["in_volume"] & truth["seen_by_c2"]
        seen.append(pose.inverse().apply(truth["points_mm"][good][::7]))
    distance = cKDTree(own.apply(cloud.points_mm)).query(np.concatenate(seen))[0]
    spacing = views[0].spacing_mm
    print(
        f"of what the views saw lit, by both cameras: {(distance < 2 * spacing).mean():.2%} have a "
        f"merged point within {2 * spacing:.2f} mm"
    )


def cells(cloud, deviation_mm, chosen=slice(None)):  # type: ignore[no-untyped-def]
    """Return the median of each cell with ten points at least, and what noise leaves of it, um."""
    corners = np.floor(cloud.points_mm[chosen] / CELL_MM).astype(int)
    which = np.unique(corners, axis=0, return_inverse=True)[1].ravel()
    order, cuts = np.argsort(which, kind="stable"), np.cumsum(np.bincount(which))[:-1]
    parts, spreads = (np.split(values[chosen][order], cuts)
                      for values in (deviation_mm, cloud.sigma_mm))  # fmt: skip
    enough = [k for k, part in enumerate(parts) if len(part) >= 10]
    medians = np.array([1e3 * np.nanmedian(parts[k]) for k in enough])
    noise = np.array([1.2533e3 * np.sqrt(np.mean(spreads[k] ** 2) / len(spreads[k]))
                      for k in enough])  # fmt: skip
    return medians, noise


def spread(medians: np.ndarray, noise: np.ndarray) -> str:
    """Say how large medians of cells are, and what of it is not noise."""
    rms, own = np.sqrt(np.mean(medians**2)), np.sqrt(np.mean(noise**2))
    return (
        f"median {np.median(medians):+.2f}, half of them within {np.median(np.abs(medians)):.1f}, "
        f"90 % within {np.percentile(np.abs(medians), 90):.1f}; rms {rms:.1f}, of which noise "
        f"{own:.1f}, leaves {np.sqrt(max(rms**2 - own**2, 0)):.1f}"
    )


def _from_creases(mesh, points_mm: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Return how far points lie from edges of the mesh that bend by more than 20 degrees, mm."""
    body = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=True)
    edges = body.vertices[body.face_adjacency_edges[body.face_adjacency_angles > CREASE]]
    steps = [np.linspace(0, 1, max(int(np.linalg.norm(b - a) / 0.2), 1) + 1) for a, b in edges]
    along = [a + t[:, None] * (b - a) for (a, b), t in zip(edges, steps, strict=True)]
    return np.asarray(cKDTree(np.concatenate(along)).query(points_mm)[0])


def _robust(values_mm: np.ndarray) -> float:
    return 1482.6 * float(np.nanmedian(np.abs(values_mm - np.nanmedian(values_mm))))


def bad_view(paths, views, true) -> None:  # type: ignore[no-untyped-def]
    """Give one view a calibration that is 0.05 degrees off, in three directions."""
    scan = read_scan(paths[BAD])
    assert scan.rig is not None
    for seed in range(3):
        rig = knocked(scan.rig, "c2", turn_deg=0.05, shift_mm=0.0, seed=seed)
        points = measure(replace(scan, rig=rig), OPTIONS).points
        assert points is not None
        if not points.is_valid.any():
            print(f"view {views[BAD].name}, c2 turned by 0.05 deg: no points left")
            continue
        changed = list(views)
        view = surface_view(views[BAD].name, views[BAD].camera, points.points_mm,
                            points.sigma_mm, position=views[BAD].position)  # fmt: skip
        changed[BAD] = split_edges(view)[0]
        odd = odd_views(register(changed, RegisterOptions(n_samples=1500), start=true))
        print(f"view {views[BAD].name}, c2 turned by 0.05 deg: named "
              f"{[(views[o.view].name, o.why) for o in odd]}")  # fmt: skip


if __name__ == "__main__":
    main()
