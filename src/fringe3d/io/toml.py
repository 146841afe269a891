"""TOML files, checked against a schema with messages that tell what to do."""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fringe3d.errors import Fringe3DError

Schema = TypeVar("Schema", bound="StrictModel")


class StrictModel(BaseModel):
    """A table in a file: unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def read_toml(path: Path, schema: type[Schema], error: type[Fringe3DError], /) -> Schema:
    """Read a TOML file into `schema`; raise `error` with one clear message."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise error(f"{path}: expected a file, found none. Check the path") from None
    except IsADirectoryError:
        raise error(f"{path}: expected a file, found a folder. Name the file in it") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{path}: cannot be read: {problem}. Check the file") from None
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{path}: expected TOML, but {problem}. Mend that line") from None
    try:
        return schema.model_validate(table)
    except ValidationError as problem:
        raise error(f"{path}: {_first_problem(problem, schema)}") from None


def _first_problem(problem: ValidationError, schema: type[BaseModel]) -> str:
    """Say the first problem; an unknown key first, for it explains a missing one."""
    errors = problem.errors(include_url=False)
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = _keys(schema)
        close = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        hint = f"Did you mean '{close[0]}'?" if close else f"Known keys: {', '.join(sorted(known))}"
        return f"unknown key '{where}'. {hint}"
    if first["type"] == "missing":
        return f"the key '{where}' is missing. Add it"
    message = str(first["msg"]).removeprefix("Value error, ")
    found = first.get("input")
    shown = "" if isinstance(found, dict) else f", found {found!r}"
    return f"{where}: {message}{shown}"


def _keys(schema: type[BaseModel]) -> set[str]:
    """Return all keys of a schema and of the tables inside it."""
    names: set[str] = set()
    queue: list[Any] = [schema]
    seen: list[Any] = []
    while queue:
        item = queue.pop()
        if item in seen:
            continue
        seen.append(item)
        if isinstance(item, type) and issubclass(item, BaseModel):
            names |= set(item.model_fields)
            queue += [field.annotation for field in item.model_fields.values()]
        else:
            queue += list(getattr(item, "__args__", ()))
            origin = getattr(item, "__origin__", None)
            if origin is not None and not isinstance(origin, type):
                queue.append(origin)
    return names
