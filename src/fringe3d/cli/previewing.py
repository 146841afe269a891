"""What the cameras see, in the browser, before it is recorded."""

from __future__ import annotations

from collections.abc import Callable

import rich

from fringe3d.acquire import Devices
from fringe3d.cli.parameters import view_installed
from fringe3d.live import SlidingWindow, shown
from fringe3d.model import PatternPlan


def preview(
    devices: Devices, plan: PatternPlan, tell: Callable[[str], None], /, *, host: str, port: int
) -> None:
    """Show the plan round and round, and modulation and saturation, until the page says to go on.

    Parameters
    ----------
    devices : Devices, open
    plan : PatternPlan
    tell : called with the address of the page
    host, port : where it is
    """
    with view_installed("record --preview", ", or leave --preview out"):
        from fringe3d.view.stream import PreviewView
    rich.reconfigure(quiet=True)  # the banner of the server, on standard output
    page = PreviewView(list(devices.infos), host=host, port=port)
    try:
        tell(f"{page.address} shows what the cameras see; its button 'record' goes on")
        window = SlidingWindow(plan, devices.infos)
        for moment in shown(devices, plan):
            ordered = window.add(moment)
            if page.is_asked_for.is_set():
                return
            if ordered and window.newest == plan.n_images - 1:
                page.show(window.stacks(ordered))
    finally:
        page.close()
