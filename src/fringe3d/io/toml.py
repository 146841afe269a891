"""TOML files, checked against a schema with messages that tell what to do."""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fringe3d.errors import Fringe3DError

Schema = TypeVar("Schema", bound="StrictModel")

MAX_SHOWN = 80
"""Characters of a wrong value that a message repeats."""


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
        raise error(f"{path}: expected TOML, found a mistake: {problem}. Mend that line") from None
    try:
        return schema.model_validate(table)
    except ValidationError as problem:
        raise error(f"{path}: {first_problem(problem, schema, table)}") from None


def first_problem(problem: ValidationError, schema: type[BaseModel], table: dict[str, Any]) -> str:
    """Say the first problem: another kind of file, an unknown key (it explains a missing one)."""
    errors = problem.errors(include_url=False)
    first = min(errors, key=lambda e: (e["loc"] != ("format",), e["type"] != "extra_forbidden"))
    kind, loc, found = first["type"], first["loc"], first["input"]
    where = _place(loc, table)
    if kind == "extra_forbidden":
        known = _keys(schema)
        close = difflib.get_close_matches(str(loc[-1]), known, n=1)
        hint = f"Did you mean '{close[0]}'?" if close else f"Known keys: {', '.join(sorted(known))}"
        return f"unknown key '{where}'. {hint}"
    if kind == "missing" and isinstance(loc[-1], int):
        where = _place(loc[:-1], table)
        return f"{where}: expected at least {loc[-1] + 1} entries, found {len(found)}. Correct it"
    if kind in ("missing", "union_tag_not_found"):
        key = where if kind == "missing" else f"{where}.kind"
        return f"the key '{key}' is missing. Add it"
    message = str(first["msg"]).removeprefix("Value error, ")
    if kind in _EXPECTED:
        message = f"expected {_EXPECTED[kind].format(**first.get('ctx', {}))}"
    found = first.get("ctx", {}).get("tag", found)
    shown = "" if isinstance(found, dict) else f", found {_short(found)}"
    to_do = "Is this another kind of file?" if loc == ("format",) else "Correct it"
    return f"{where}{': ' if where else ''}{message}{shown}. {to_do}"


_EXPECTED = {
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number of at least {ge}",
    "less_than_equal": "a number of at most {le}",
    "string_type": "a text in quotes",
    "list_type": "a list",
    "tuple_type": "a list",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "too_short": "at least {min_length} entries",
    "too_long": "at most {max_length} entries",
    "literal_error": "{expected}",
    "union_tag_invalid": "one of the kinds {expected_tags}",
}
"""What a value should have been, for the schema's kinds of error."""


def _place(loc: tuple[int | str, ...], table: dict[str, Any]) -> str:
    """Return a place in the file as a reader would name it: ``devices[1] 'c2': focal_px[0]``."""
    where = ""
    item: Any = table
    for part in loc:
        if isinstance(part, int):
            item = item[part] if isinstance(item, list) and part < len(item) else None
            where += f"[{part}]"
            if isinstance(item, dict) and isinstance(item.get("name"), str):
                where += f" '{item['name']}': "
        elif isinstance(item, dict) and part == item.get("kind"):
            continue  # the schema's name of the table, which is not in the file
        else:
            item = item.get(part) if isinstance(item, dict) else None
            where += f"{'.' if where and not where.endswith(' ') else ''}{part}"
    return where.removesuffix(": ")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


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
