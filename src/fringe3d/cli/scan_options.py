"""What the calibrations have in common: options that name scans, and how to end."""

# Types, not their names: options that inherit from these are resolved in their own modules.

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Overwrite, at_least
from fringe3d.errors import MethodError
from fringe3d.model import Scan
from fringe3d.options import MeasureOptions


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RigOptions:
    """What every calibration asks for.

    Parameters
    ----------
    out
        The rig file to write.
    """

    out: Path
    rig: Path | None = None
    depth: str | None = None
    overwrite: Overwrite = False

    @property
    def depth_mm(self) -> tuple[float, float] | None:
        """Return the depth range, mm."""
        from fringe3d.io.importing import parse_depth

        return parse_depth(self.depth) if self.depth else None


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ScanOptions(RigOptions):
    """Scans that a calibration starts from.

    Parameters
    ----------
    from_
        Scan folder or scan file; repeat it for several scans of the same rig.
    rig
        Rig file instead of the scan's own.
    images
        Folder of the images, where they do not lie beside the scan file; repeat it for each scan.
    depth
        MIN:MAX, mm along the principal ray of C1: the range to use; needed where the rig has no
        measuring volume and orders are not numbered.
    """

    from_: Annotated[list[Path], Parameter(name="--from", negative=())]
    images: Annotated[list[Path] | None, Parameter(negative=())] = None


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SomeImagesOptions(ScanOptions):
    """Scans of which not all images are used.

    Parameters
    ----------
    shifts
        Use only that many of the phase steps.
    gray_bits
        Use only the finest images of each Gray code; 0 for none.
    """

    shifts: int | None = None
    gray_bits: Annotated[int | None, Parameter(validator=at_least(0))] = None

    @property
    def measuring(self) -> MeasureOptions:
        """Return the same as options of a measurement."""
        return MeasureOptions(
            n_shifts=self.shifts, gray_bits=self.gray_bits, depth_mm=self.depth_mm
        )


def read_scans(options: ScanOptions, reporter: Reporter, /) -> list[Scan]:
    """Read the scans that a calibration starts from.

    Raises
    ------
    MethodError
        If folders of images are named for some of the scans only.
    """
    from fringe3d.io.recording import read_scan

    given = options.images or []
    if len(given) not in (0, 1, len(options.from_)):
        raise MethodError(
            f"--images: expected one folder for all scans or one for each of the "
            f"{len(options.from_)}, found {len(given)}. Leave some out"
        )
    folders: list[Path | None] = [*given] or [None]
    folders = folders * len(options.from_) if len(folders) == 1 else folders
    return [
        read_scan(path, images=images, rig=options.rig, progress=reporter.step)
        for path, images in zip(options.from_, folders, strict=True)
    ]


def tell(
    run: Callable[[Reporter], tuple[str, dict[str, Any]]], out: Path, /, *, as_json: bool
) -> None:
    """Run a calibration, print its warnings, then what it says or its record."""
    with Reporter(quiet=as_json).running() as reporter:
        text, record = run(reporter)
    for finding in record.get("health", ()):
        if finding["level"] != "ok":
            reporter.warn(finding["text"])
    say(f"{text}\n\n-> {out}", record, as_json=as_json)
