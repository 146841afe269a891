"""The commands."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from fringe3d import __version__
from fringe3d.cli.console import Reporter, say
from fringe3d.errors import MethodError

app = App(
    name="fringe3d",
    version=__version__,
    help="Fringe-projection 3D measurement with few images. Lengths in mm, pixels from 0.",
    suppress_keyboard_interrupt=False,  # main() says that nothing was written
)

Json = Annotated[bool, Parameter(name="--json", negative=(), help="Print the result as JSON.")]
Overwrite = Annotated[bool, Parameter(negative=(), help="Replace what is there.")]


def _at_least(low: float) -> Callable[[type, Any], None]:
    """Return a check that a number, or each of several, is finite and not below `low`."""

    def check(_type: type, value: Any) -> None:
        for number in value if isinstance(value, list) else [value]:
            if number is not None and not low <= number < math.inf:
                raise ValueError(f"Expected a number of at least {low:g}.")

    return check


SIMULATOR_PACKAGES = ("embreex", "manifold3d", "skimage", "trimesh")


@contextmanager
def _simulator_installed(command: str) -> Iterator[None]:
    """Say what to install if the block finds a package of the simulator missing."""
    try:
        yield
    except ModuleNotFoundError as problem:
        missing = (problem.name or "").partition(".")[0]
        if missing not in SIMULATOR_PACKAGES:
            raise
        raise MethodError(
            f"{command}: expected the packages of the simulator, found no '{missing}'. Install "
            "them: pip install 'fringe3d[simulate]'"
        ) from None


@app.command
def measure(
    scan: Path,
    /,
    *,
    out: Path,
    images: Path | None = None,
    rig: Path | None = None,
    method: Literal["auto", "m0", "m1", "m2", "m3", "m4", "m5", "projector"] = "auto",
    direction: Literal["auto", "x", "y"] = "auto",
    shifts: int | None = None,
    gray_bits: Annotated[int | None, Parameter(validator=_at_least(0))] = None,
    light_dark: bool = True,
    depth: str | None = None,
    strict: Annotated[bool, Parameter(negative=())] = False,
    drop_edges: Annotated[bool, Parameter(negative=())] = False,
    min_modulation: Annotated[float | None, Parameter(validator=_at_least(0))] = None,
    min_probability: Annotated[float | None, Parameter(validator=_at_least(0))] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Turn a recording into a point cloud.

    Leaves points.npz, cloud.ply, overview.png and measure.toml in OUT.
    Example: fringe3d measure scan --out result --depth 600:800

    Parameters
    ----------
    scan
        Scan folder (with a scan.toml), or a scan file.
    out
        Folder for the result; must not exist yet.
    images
        Folder of the images, where they do not lie beside the scan file.
    rig
        Rig file to use instead of the scan's own.
    method
        auto takes the best that images and rig allow, and says why. Two cameras: m0 full Gray
        code in two directions, m1 full code, m2 reduced code, m3 fringes alone, m4 fringes of two
        directions, m5 fringes alone and segments below one period; each leaves out the images
        that it does without. projector: one camera and the calibrated projector.
    direction
        Use only the fringes and code of this direction (x: vertical stripes).
    shifts
        Use only that many of the phase steps.
    gray_bits
        Use only the finest images of each Gray code; 0 for none.
    light_dark
        Use light and dark images for the threshold of the code, where there are any.
    depth
        MIN:MAX, mm along the principal ray of C1; needed with few bits.
    strict
        Metrology: fewer wrong points, at the price of uncertain ones and small patches.
    drop_edges
        Leave out points next to depth edges, where light of two surfaces mixes.
    min_modulation
        Smallest fringe contrast, grey levels.
    min_probability
        Reject fringe orders that are less probable, 0 to 1; 0 takes the best that fits.
    """
    from fringe3d.io.atomic import require_writable
    from fringe3d.io.importing import parse_depth
    from fringe3d.io.recording import read_scan
    from fringe3d.options import MeasureOptions
    from fringe3d.pipeline import measure as run
    from fringe3d.report.folder import Request, measure_record, summary, write_result

    require_writable(out, overwrite=overwrite, inputs=(scan, images, rig))
    options = MeasureOptions(
        method=method,
        direction=direction,
        n_shifts=shifts,
        gray_bits=gray_bits,
        light_dark=light_dark,
        depth_mm=parse_depth(depth) if depth else None,
        strict=strict,
        drop_edges=drop_edges,
        min_modulation_dn=min_modulation,
        min_order_probability=min_probability,
    )
    command = shlex.join(["fringe3d", *sys.argv[1:]])
    request = Request(command=command, scan=scan, images=images, rig=rig)
    with Reporter(quiet=as_json).running() as reporter:
        recording = read_scan(scan, images=images, rig=rig, progress=reporter.step)
        result = run(recording, options, stage=reporter.stage)
        reporter.stage("writing")
        write_result(out, recording, options, result, request=request, overwrite=overwrite)
    if method == "auto":
        reporter.note(f"method {result.method}: {result.why}")
    for finding in result.warnings:
        reporter.warn(finding.text)
    record = measure_record(recording, options, result, request=request) | {"out": str(out)}
    say(f"{summary(result)} -> {out}", record, as_json=as_json)


@app.command
def patterns(
    *,
    size: str,
    out: Path,
    period: list[float],
    steps: int = 4,
    direction: Literal["x", "y", "xy"] | None = None,
    angle: Annotated[float | None, Parameter(validator=_at_least(-360))] = None,
    reverse: Annotated[bool, Parameter(negative=())] = False,
    gray: Literal["complementary", "plain", "none"] = "complementary",
    gray_bits: Annotated[int | None, Parameter(validator=_at_least(1))] = None,
    inverses: Annotated[bool, Parameter(negative=())] = False,
    light_dark: Annotated[bool, Parameter(negative=())] = False,
    bits: Literal[8, 16] = 8,
    overwrite: Overwrite = False,
) -> None:
    """Write the images to project, and the plan that travels with them.

    Leaves 000.png ..., plan.toml and overview.png in OUT.
    Example: fringe3d patterns --size 1024x768 --period 16 --steps 4 --out patterns

    Parameters
    ----------
    size
        Projector pixels, WIDTHxHEIGHT.
    out
        Folder for the images; must not exist yet.
    period
        Fringe period, projector px, at least 2; need not be an integer; repeat it for several.
    steps
        Phase steps, at least 3; 0 for Gray code alone with cells of the period.
    direction
        x: vertical fringes (the default), y: horizontal, xy: both.
    angle
        Fringe angle in degrees instead of a direction; 0 is x, 90 is y.
    reverse
        Shift the fringes the other way.
    gray
        complementary codes half periods (one image more, no errors at the edges).
    gray_bits
        Tell 2^n periods apart, cyclically; as many as there are by default.
    inverses
        Add the inverse of each Gray-code image.
    light_dark
        Add a light and a dark image.
    bits
        Bit depth of the images.
    """
    from fringe3d.io.importing import parse_size
    from fringe3d.patterns import require_numbered, sequence
    from fringe3d.report.patterns import write_patterns

    width, height = parse_size(size, "--size")
    if angle is not None and direction is not None:
        raise MethodError(
            f"--angle, --direction: expected one of them, found {angle:g} and {direction}. Leave "
            "one out"
        )
    if angle is not None:
        angles: tuple[float, ...] = (math.radians(angle),)
    else:
        angles = tuple({"x": 0.0, "y": math.pi / 2}[name] for name in direction or "x")
    try:
        plan = sequence(
            (height, width),
            periods_px=tuple(period),
            n_shifts=steps,
            angles=angles,
            reverse=reverse,
            gray=gray,
            gray_bits=gray_bits,
            inverses=inverses,
            light_dark=light_dark,
        )
        require_numbered(plan)
    except ValueError as problem:
        raise MethodError(f"{problem}. See fringe3d patterns --help") from None
    write_patterns(out, plan, bit_depth=bits, overwrite=overwrite)
    say(f"{plan.n_images} images of {width} x {height} px, {bits} bit -> {out}")


@app.command(name="import")
def import_(
    images: Path,
    /,
    *,
    out: Path | None = None,
    camera: list[str] | None = None,
    sequence: list[str] | None = None,
    projector_size: str | None = None,
    rig: Path | None = None,
    calibration: Path | None = None,
    calibration_keys: str | None = None,
    inverse_pose: Annotated[bool, Parameter(negative=())] = False,
    depth: str | None = None,
    bit_depth: int | None = None,
    black_level: float = 0.0,
    title: str = "",
    overwrite: Overwrite = False,
) -> None:
    """Describe a recording made by other software, and check the description.

    Writes a scan.toml (and a rig.toml). Without --camera or --sequence it asks, on a terminal,
    for these and all else that is not given; with both it asks nothing.
    Example: fringe3d import images --camera "c1={index:02d}.png"
    --sequence "fringes period_px=60 n_shifts=12" --sequence "gray cell_px=30 n_bits=6"
    --calibration stereo.yml --projector-size 1920x1080

    Parameters
    ----------
    images
        Folder of the images.
    out
        The scan file; IMAGES/scan.toml by default.
    camera
        NAME=PATTERN[@FIRST], as "c1=left/{index:02d}.png@1"; repeat it for a second camera.
    sequence
        What was projected, in recorded order, as in the [[sequence]] entries of a scan file:
        "fringes ...", "gray ...", "light", "dark" or "unused count=2"; repeat it.
    projector_size
        Projector pixels, WIDTHxHEIGHT.
    rig
        An existing rig file.
    calibration
        A calibration by OpenCV (YAML, XML, JSON), converted to rig.toml beside the scan file
        (NAME-rig.toml beside a NAME.toml).
    calibration_keys
        Names of its matrices: M1,D1,M2,D2,R,T, with :projector if the second is a projector.
    inverse_pose
        R and T map the second device to the first (OpenCV's map the first to the second).
    depth
        MIN:MAX, mm along the principal ray of C1; becomes the measuring volume.
    bit_depth
        Bits of a grey value, 8 to 16; 8 if neither given nor asked.
    black_level
        Grey value without light.
    title
        A line for pictures and reports.
    """
    from fringe3d.cli.importer import ImportOptions, import_recording

    options = ImportOptions(
        images=images,
        out=out or images / "scan.toml",
        cameras=tuple(camera or ()),
        sequence=tuple(sequence or ()),
        projector_size=projector_size,
        rig=rig,
        calibration=calibration,
        calibration_keys=calibration_keys,
        inverse_pose=inverse_pose,
        depth=depth,
        bit_depth=bit_depth,
        black_level=black_level,
        title=title,
        overwrite=overwrite,
    )
    text = import_recording(options, Reporter(quiet=False))
    say(text)


@app.command
def simulate(
    preset: str,
    /,
    *,
    out: Path,
    thing: Annotated[str, Parameter(name="--object")] = "machine-part",
    plan: str = "m1",
    seed: Annotated[int, Parameter(validator=_at_least(0))] = 0,
    steps: Annotated[int, Parameter(validator=_at_least(3))] = 4,
    period: Annotated[float | None, Parameter(validator=_at_least(2))] = None,
    camera_size: str = "640x512",
    background: Literal["table", "wall", "none"] = "table",
    rays: int = 4,
    positions: Annotated[int, Parameter(validator=_at_least(1))] = 1,
    tilts: str = "0",
    settings: Path | None = None,
    overwrite: Overwrite = False,
) -> None:
    """Record a scan without hardware, with exact truth.

    Leaves an ordinary scan folder with truth.npz, simulation.toml and overview.png in OUT.
    Example: fringe3d simulate kolibri --object teeth --plan m2 --seed 1 --out scan

    Parameters
    ----------
    preset
        The rig: kolibri, kolibri-m5, designed, wide-depth, face or single.
    out
        Folder of the scan; must not exist yet.
    thing
        plane, prism, machine-part, teeth, sphere, ball-bar, flat-plate, step-gauge, bust,
        two-bodies, thin-wire, hand, or a file: STL, PLY or OBJ, in mm.
    plan
        What is projected: the images of a method, m0 to m6, or a plan.toml.
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
        Turn the object on a rotary table to that many positions: a series of scans.
    tilts
        Tilts of the table, degrees, with commas between: a series for each.
    settings
        TOML file with [surface], [camera], [projector] and [recording]: noise, gamma, blur,
        black level, vibration, motion, dropped images ... as in the simulation.toml of any scan.
    """
    from fringe3d.io.importing import parse_size

    with _simulator_installed("simulate"):
        from fringe3d.cli.simulator import SimulateOptions, parse_tilts, run_simulation

    options = SimulateOptions(
        preset=preset,
        thing=thing,
        plan=plan,
        seed=seed,
        out=out,
        steps=steps,
        period_px=period,
        camera_size=parse_size(camera_size, "--camera-size"),
        background=background,
        n_rays=rays,
        positions=positions,
        tilts_deg=parse_tilts(tilts),
        settings=settings,
        overwrite=overwrite,
    )
    with Reporter(quiet=False).running() as reporter:
        text = run_simulation(options, reporter)
    say(text)


@app.command
def design(
    rig: str,
    /,
    *,
    period: Annotated[float | None, Parameter(validator=_at_least(2))] = None,
    angle: Annotated[float | None, Parameter(validator=_at_least(-360))] = None,
    depth: str | None = None,
    steps: Annotated[int | None, Parameter(validator=_at_least(3))] = None,
    noise: Annotated[float, Parameter(validator=_at_least(0))] = 0.01,
    calibration_error_px: Annotated[float, Parameter(validator=_at_least(0))] = 0.1,
    camera_period: Annotated[float | None, Parameter(validator=_at_least(1))] = None,
    out: Path | None = None,
    optimise: Annotated[bool, Parameter(negative=())] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Tell which images a rig needs, how certain its points are, where its projector should stand.

    Leaves design.md, design.json, rig.png, maps.png and segments.png in OUT.
    Example: fringe3d design examples/sketches/kolibri.toml --out design

    Parameters
    ----------
    rig
        A rig.toml, a sketch of a rig (distances, angles, chips), or a preset of the simulator.
    period
        Fringe period, projector px; that of sketch or preset, or 16, by default.
    angle
        Fringe angle, degrees; 0: vertical fringes.
    depth
        MIN:MAX, mm along the principal ray of C1; needed where the rig has no volume.
    steps
        Phase steps; those of the sketch, or 4, by default.
    noise
        Noise of a grey value over the fringe amplitude.
    calibration_error_px
        How far calibrated and true image points differ.
    camera_period
        Period that the second camera sees, px; needed where the projector is not calibrated.
    out
        Folder for report and pictures; must not exist yet.
    optimise
        Look for a better place of the projector and angle of the fringes.
    """
    from fringe3d.cli.designer import DesignOptions, run_design
    from fringe3d.io.importing import parse_depth

    options = DesignOptions(
        rig=rig,
        period_px=period,
        angle_deg=angle,
        depth_mm=parse_depth(depth) if depth else None,
        steps=steps,
        noise=noise,
        calibration_px=calibration_error_px,
        camera_period_px=camera_period,
        out=out,
        optimise=optimise,
        overwrite=overwrite,
    )
    with _simulator_installed("design"), Reporter(quiet=as_json).running() as reporter:
        text, record = run_design(options, reporter)
    say(text, record, as_json=as_json)


@app.command
def demo(*, out: Path = Path("demo"), overwrite: Overwrite = False) -> None:
    """Measure a simulated scan of a machine part, and compare it with the truth.

    Leaves the scan in OUT/scan and the result in OUT/result: look at overview.png.

    Parameters
    ----------
    out
        Folder for scan and result.
    """
    with _simulator_installed("demo"):
        from fringe3d.cli.demo import run_demo

    with Reporter(quiet=False).running() as reporter:
        text = run_demo(out, overwrite=overwrite, reporter=reporter)
    say(text)
