"""A simulated scan in one call."""

from __future__ import annotations

from fringe3d.model import Scan
from fringe3d.patterns import method_plan
from fringe3d.simulate.objects import OBJECTS
from fringe3d.simulate.optics import Surface
from fringe3d.simulate.presets import PRESETS
from fringe3d.simulate.render import Setup, prepare, record
from fringe3d.simulate.truth import Truth


def simulate(
    preset: str,
    thing: str,
    method: str = "m1",
    /,
    *,
    size: tuple[int, int] = (640, 512),
    n_shifts: int = 4,
    seed: int = 0,
    surface: Surface | None = None,
    background: str = "table",
    setup: Setup | None = None,
) -> tuple[Scan, Truth]:
    """Record an object with one of the rigs of the simulator, as ``fringe3d simulate`` does.

    Parameters
    ----------
    preset : str; a name in `PRESETS`
    thing : str; a name in `OBJECTS`
    method : str; the images of which method, see `fringe3d.patterns.method_plan`
    size : (n_cols, n_rows) of the cameras
    n_shifts : int, >= 3; phase steps
    seed : int; of the noise
    surface : Surface or None (default)
    background : "table", "wall" or "none"
    setup : Setup or None (default); lenses, noise and what goes wrong

    Returns
    -------
    Scan, Truth
        The recording, and what is true on the pixels of C1.

    Raises
    ------
    ValueError
        If there is no such preset or object.

    Examples
    --------
    >>> scan, truth = simulate("kolibri", "sphere", "m3", size=(64, 48))
    >>> scan.stacks[0].images.shape, truth.points_mm.shape
    ((4, 48, 64), (48, 64, 3))
    """
    for name, known in ((preset, PRESETS), (thing, OBJECTS)):
        if name not in known:
            raise ValueError(f"simulate: expected one of {', '.join(known)}, found '{name}'")
    made = PRESETS[preset](size)
    assert made.rig.projector is not None
    plan = method_plan(
        method,
        made.rig.projector.shape,
        period_px=made.period_px,
        n_shifts=n_shifts,
        reduced_bits=made.reduced_bits,
        angle=made.fringe_angle,
    )
    scene = made.scene(OBJECTS[thing](), surface, background=background)
    stage = prepare(made.rig, scene, setup)
    title = f"{thing} on {preset}, plan {method}"
    return record(stage, plan, seed=seed, title=title), stage.truths[0]
