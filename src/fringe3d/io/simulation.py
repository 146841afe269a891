"""Settings of a simulation, and its truth on disk."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import create_model

from fringe3d.errors import PlanError
from fringe3d.io.toml import StrictModel, read_toml


def read_settings(
    path: Path, kinds: dict[str, type], /, *, ignored: Iterable[str] = ()
) -> dict[str, Any]:
    """Read tables of settings, each checked against the fields of a dataclass.

    Parameters
    ----------
    path : TOML file
    kinds : dict of table name to dataclass
    ignored : keys beside the tables that may be there

    Returns
    -------
    dict of str to instance of the dataclass; tables that are missing have their defaults

    Raises
    ------
    PlanError
        If a table or key is unknown, or a value outside its domain.
    """
    tables = {name: (_schema(name, kind), _schema(name, kind)()) for name, kind in kinds.items()}
    rest = dict.fromkeys(ignored, (Any, None))
    schema: type[StrictModel] = create_model("Settings", __base__=StrictModel, **tables, **rest)  # type: ignore[call-overload]
    read = read_toml(path, schema, PlanError)
    try:
        return {name: kind(**getattr(read, name).model_dump()) for name, kind in kinds.items()}
    except ValueError as problem:
        raise PlanError(f"{path}: {problem}. Correct it") from None


def _schema(name: str, kind: type) -> type[StrictModel]:
    fields = {f.name: (f.type, f.default) for f in dataclasses.fields(kind)}
    namespace = {"__module__": kind.__module__}
    model = create_model(name, __base__=StrictModel, **fields)  # type: ignore[call-overload]
    model.model_rebuild(_types_namespace=namespace)
    return model  # type: ignore[no-any-return]


def settings_text(head: dict[str, Any], tables: dict[str, Any], /) -> str:
    """Return settings as TOML: plain keys first, then a table for each dataclass."""
    document = tomlkit.document()
    for key, value in head.items():
        document[key] = value
    for name, settings in tables.items():
        document[name] = {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in dataclasses.asdict(settings).items()
        }
    return tomlkit.dumps(document)


def write_truth(path: Path, maps: dict[str, NDArray[Any]], /) -> None:
    """Write the true maps as NPZ."""
    np.savez_compressed(path, allow_pickle=False, **maps)
