"""Commands that need no hardware: simulate, demo, evaluate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, app, at_least, simulator_installed

evaluate = App(name="evaluate", help="Judge methods and results.")
app.command(evaluate)


@app.command
def simulate(
    preset: str,
    /,
    *,
    out: Path,
    thing: Annotated[str, Parameter(name="--object")] = "machine-part",
    plan: str | None = None,
    seed: Annotated[int, Parameter(validator=at_least(0))] = 0,
    steps: Annotated[int, Parameter(validator=at_least(3))] = 4,
    period: Annotated[float | None, Parameter(validator=at_least(2))] = None,
    camera_size: str = "640x512",
    background: Literal["table", "wall", "none"] = "table",
    rays: int = 4,
    positions: Annotated[int | None, Parameter(validator=at_least(1))] = None,
    tilts: str = "0",
    settings: Path | None = None,
    bend: Annotated[float, Parameter(validator=at_least(0))] = 0.0,
    print_error: Annotated[float, Parameter(validator=at_least(0))] = 0.0,
    knock: Annotated[list[str] | None, Parameter(negative=())] = None,
    axis_off: str = "0mm:0deg",
    angle_error: Annotated[float, Parameter(validator=at_least(0))] = 0.0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Record a scan without hardware, with exact truth.

    Leaves an ordinary scan folder with truth.npz, simulation.toml and overview.png in OUT.
    A calibration board becomes a series of poses for fringe3d calibrate.
    Example: fringe3d simulate kolibri --object teeth --plan m2 --seed 1 --out scan

    Parameters
    ----------
    preset
        The rig: kolibri, kolibri-m5, designed, wide-depth, face or single.
    out
        Folder of the scan; must not exist yet.
    thing
        plane, prism, machine-part, teeth, sphere, ball-bar, flat-plate, step-gauge, bust,
        two-bodies, thin-wire, hand, or a file: STL, PLY or OBJ, in mm. Or a board, as
        chessboard:9x7:7mm, charuco:11x8:7mm:5mm, circles:9x7:7mm, asymmetric-circles:4x11:5mm or a
        board.toml, held into the volume.
    plan
        What is projected: the images of a method, m0 to m6, or a plan.toml; m1 by default, m0 for a
        board.
    seed
        The same seed gives the same bytes.
    steps
        Phase steps.
    period
        Fringe period, projector px; that of the preset by default.
    camera_size
        Pixels of the cameras, WIDTHxHEIGHT.
    background
        What the object stands on or hangs before; lit and seen, outside the measuring volume.
    rays
        Rays for each pixel: 1, 4, 9 or 16.
    positions
        Turn the object on a rotary table to that many positions: a series of scans. Poses of a
        board; 12 by default.
    tilts
        Tilts of the table, degrees, with commas between: a series for each.
    settings
        TOML file with [surface], [camera], [projector] and [recording]: noise, gamma, blur,
        black level, vibration, motion, dropped images ... as in the simulation.toml of any scan.
    bend
        By how much the rim of a board is bent, mm.
    print_error
        Standard deviation of the places of its corners, mm.
    knock
        Device that moved since the calibration, as c2:0.05deg:0.1mm: rig.toml is the former rig,
        true-rig.toml the one that recorded. Repeat it for several.
    axis_off
        How far the table's axis lies beside the world's z axis and leans, as 5mm:2deg, in random
        directions. Nominal angles are in scan.toml, poses and axis in truth.npz.
    angle_error
        Standard deviation of the table's angles from the nominal ones, degrees.
    """
    from fringe3d.io.importing import parse_size

    with simulator_installed("simulate"):
        from fringe3d.cli.board_simulator import N_POSES, is_board
        from fringe3d.cli.simulation_words import parse_tilts
        from fringe3d.cli.simulator import SimulateOptions, run_simulation

    default_plan, default_positions = ("m0", N_POSES) if is_board(thing) else ("m1", 1)
    options = SimulateOptions(
        preset=preset,
        thing=thing,
        plan=plan or default_plan,
        seed=seed,
        out=out,
        steps=steps,
        period_px=period,
        camera_size=parse_size(camera_size, "--camera-size"),
        background=background,
        n_rays=rays,
        positions=positions or default_positions,
        tilts_deg=parse_tilts(tilts),
        settings=settings,
        bend_mm=bend,
        print_error_mm=print_error,
        knocks=tuple(knock or ()),
        axis_off=axis_off,
        angle_error_deg=angle_error,
        overwrite=overwrite,
    )
    with Reporter(quiet=as_json).running() as reporter:
        text, record = run_simulation(options, reporter)
    say(text, record, as_json=as_json)


@app.command
def demo(*, out: Path = Path("demo"), overwrite: Overwrite = False, as_json: Json = False) -> None:
    """Measure a simulated scan of a machine part, and compare it with the truth.

    Leaves the scan in OUT/scan and the result in OUT/result: look at overview.png.
    Example: fringe3d demo --out demo, then fringe3d view demo/result

    Parameters
    ----------
    out
        Folder for scan and result.
    """
    with simulator_installed("demo"):
        from fringe3d.cli.demo import run_demo

    with Reporter(quiet=as_json).running() as reporter:
        text, record = run_demo(out, overwrite=overwrite, reporter=reporter)
    say(text, record, as_json=as_json)


@evaluate.command
def paper(
    *,
    steps: str = "16,4",
    objects: str = "plane,prism,machine-part,teeth",
    noise: Annotated[float, Parameter(validator=at_least(0))] = 0.01,
    calibration_error_px: Annotated[float, Parameter(validator=at_least(0))] = 0.05,
    seed: Annotated[int, Parameter(validator=at_least(0))] = 1,
    camera_size: str = "640x512",
    period: Annotated[float | None, Parameter(validator=at_least(2))] = None,
    jobs: Annotated[int | None, Parameter(validator=at_least(1))] = None,
    out: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Repeat the source paper's experiment with simulated scans: all methods on the same images.

    Prints completeness and wrong points of M1 to M5, the numbers of images, and the sigma of the
    plane, beside the paper's figures. With OUT it leaves paper.md, figures and error maps there.
    Example: fringe3d evaluate paper --steps 4 --objects plane,teeth --out paper

    Parameters
    ----------
    steps
        Phase steps, with commas between.
    objects
        Objects, with commas between.
    noise
        Noise of a grey value over the modulation of the plane.
    calibration_error_px
        How far calibrated and true image points differ, rms in the second camera.
    seed
        The same seed gives the same figures.
    camera_size
        Pixels of the cameras, WIDTHxHEIGHT.
    period
        Fringe period, projector px; that of the preset by default.
    jobs
        Processes that share the work; one for each core by default.
    out
        Folder for report and pictures; must not exist yet.
    """
    from fringe3d.io.importing import parse_size

    with simulator_installed("evaluate paper"):
        from fringe3d.cli.paper import PaperOptions, parse_steps, run_paper

    options = PaperOptions(
        steps=parse_steps(steps),
        objects=tuple(objects.split(",")),
        noise=noise,
        calibration_error_px=calibration_error_px,
        seed=seed,
        camera_size=parse_size(camera_size, "--camera-size"),
        period_px=period,
        out=out,
        overwrite=overwrite,
        jobs=jobs,
    )
    with Reporter(quiet=as_json).running() as reporter:
        text, record = run_paper(options, reporter)
    say(text, record, as_json=as_json)
