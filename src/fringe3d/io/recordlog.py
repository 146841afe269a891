"""``recording.toml``: how a scan was recorded, and what had to be recorded again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit


def write_record_log(
    folder: Path,
    head: Mapping[str, Any],
    cameras: Sequence[Mapping[str, Any]],
    mended: Sequence[Mapping[str, Any]],
    /,
) -> None:
    """Write the log of a recording into its scan folder.

    Parameters
    ----------
    folder : Path
    head : command, latency and other single values
    cameras : one table for each camera: what it is, how it exposed, when
    mended : one table for each thing that went wrong and was recorded again
    """
    table = dict(head) | {"cameras": [dict(c) for c in cameras]}
    if mended:
        table["mended"] = [dict(entry) for entry in mended]
    (folder / "recording.toml").write_text(tomlkit.dumps(table), encoding="utf-8")
