"""``fringe3d merge``: views from all sides to one body."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, app, at_least

Format = Literal["ply", "stl", "obj", "e57"]


@app.command
def merge(
    *scans: Path,
    out: Path,
    angles: Literal["auto", "known", "rough", "unknown", "free"] = "auto",
    turns: str | None = None,
    axis: Path | None = None,
    rig: Path | None = None,
    images: Path | None = None,
    method: Literal["auto", "m0", "m1", "m2", "m3", "m4", "m5", "m6", "projector"] = "auto",
    depth: str | None = None,
    filter_: Annotated[
        Literal["none", "light", "medium", "strong"], Parameter(name="--filter")
    ] = "none",
    keep_edges: Annotated[bool, Parameter(negative=())] = False,
    mesh: Literal["none", "poisson", "edges"] = "none",
    holes: Literal["open", "closed"] = "open",
    formats: str = "ply",
    reference: Path | None = None,
    jobs: Annotated[int | None, Parameter(validator=at_least(1))] = None,
    skip_broken: Annotated[bool, Parameter(negative=())] = False,
    despite_conflicts: Annotated[bool, Parameter(negative=())] = False,
    recalibrate: Annotated[bool, Parameter(negative=())] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Bring scans from all sides into one frame, and make one surface of them.

    Scans are measured first, several at once; each is kept in OUT-views as soon as it is done, so
    that an interrupted run goes on where it stopped. Leaves cloud.ply, merge.json, table.toml,
    report.html and pictures in OUT; with --mesh also a mesh.
    Examples: fringe3d merge scans --out body; fringe3d merge scans --out body --mesh poisson
    --holes closed --formats ply,stl; fringe3d merge a b c --out body --angles free

    Parameters
    ----------
    scans
        Scan folders or files, result folders of fringe3d measure, or folders that hold several.
    out
        Folder for the body; must not exist yet.
    angles
        Of the rotary table, as [table] in scan.toml or --turns says them: known, rough (to 2
        degrees), unknown (a table that nobody read), free (no table: a body or a rig moved by
        hand). auto: known where all scans have one, free otherwise.
    turns
        Angles of the table for the scans in their order, degrees, with commas between.
    axis
        A table.toml of an earlier merge, or of fringe3d calibrate table: where the axis is.
    rig
        Rig file to use instead of the scans' own.
    images
        Folder of the images, where they do not lie beside the scan files.
    method
        As for fringe3d measure.
    depth
        MIN:MAX, mm along the principal ray of C1.
    filter_
        As for fringe3d measure.
    keep_edges
        Take points next to depth edges, where light of two surfaces mixes, for as good as others.
        Without it they count only where no other view sees the place.
    mesh
        poisson: smooth, through the noise. edges: through the points, so that edges stay.
    holes
        closed: the mesh is watertight, also where nothing was seen.
    formats
        Of cloud and mesh, with commas between: ply, stl, obj (meshes), e57 (the cloud).
    reference
        A mesh (STL, PLY, OBJ) in the frame of the first scan, or anywhere: the cloud is fitted to
        it, and deviations are drawn.
    jobs
        Scans measured at a time; one for each core by default.
    skip_broken
        Leave out scans that cannot be measured, and say which.
    despite_conflicts
        Go on where views that shape alone placed (unknown, free) contradict each other: one camera
        looked through what another one saw.
    recalibrate
        Find poses and focal lengths of the rig's devices again, from all overlaps. If the rig was
        off, everything is measured and registered anew with the rig found, which is left as
        OUT/rig.toml.
    """
    from fringe3d.cli.merge_run import (
        MergeOptions,
        parse_formats,
        parse_turns,
        run_merge,
        telling_what_is_kept,
    )
    from fringe3d.io.importing import parse_depth
    from fringe3d.options import MeasureOptions

    options = MergeOptions(
        scans=scans, out=out, angles=angles, turns_deg=parse_turns(turns), axis=axis, rig=rig,
        images=images, mesh=mesh, closed=holes == "closed", formats=parse_formats(formats),
        reference=reference, jobs=jobs, skip_broken=skip_broken, keep_edges=keep_edges,
        despite_conflicts=despite_conflicts, recalibrate=recalibrate, overwrite=overwrite,
        command=shlex.join(["fringe3d", *sys.argv[1:]]),
        measuring=MeasureOptions(method=method, depth_mm=parse_depth(depth) if depth else None,
                                 filter=filter_),
    )  # fmt: skip
    with Reporter(quiet=as_json).running() as reporter, telling_what_is_kept(out):
        text, record = run_merge(options, reporter)
    say(text, record, as_json=as_json)
