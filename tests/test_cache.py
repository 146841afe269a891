"""The cache on disk gives back what was put in, and never stands in the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fringe3d.io.cache import SWITCH, cached, key_of, mapped

ARRAYS = {"a": np.arange(6.0).reshape(2, 3), "b": np.array([True, False])}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(SWITCH, str(tmp_path / "cache"))
    return tmp_path / "cache"


def never() -> dict[str, np.ndarray]:
    raise AssertionError("made again")


def test_arrays_are_made_once(folder: Path) -> None:
    key = key_of(["x"])
    first = cached(key, lambda: ARRAYS)
    second = cached(key, never)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(array, first[name])
        np.testing.assert_array_equal(array, second[name])
        assert array.dtype == second[name].dtype
    assert [p.name for p in folder.iterdir()] == [f"{key}.npz"]


@pytest.mark.parametrize("spoil", ["cut", "flipped", "empty", "text", "npy"])
def test_a_spoiled_entry_is_made_again(folder: Path, spoil: str) -> None:
    key = key_of(["x"])
    cached(key, lambda: ARRAYS)
    file = folder / f"{key}.npz"
    data = file.read_bytes()
    if spoil == "npy":
        with file.open("wb") as handle:
            np.save(handle, np.arange(3))
    else:
        middle = len(data) // 3
        flipped = data[:middle] + bytes(255 - b for b in data[middle : middle + 40])
        file.write_bytes(
            {"cut": data[: len(data) // 2], "flipped": flipped + data[middle + 40 :],
             "empty": b"", "text": b"no archive"}[spoil]
        )  # fmt: skip
    again = cached(key, lambda: ARRAYS)
    np.testing.assert_array_equal(ARRAYS["a"], again["a"])
    np.testing.assert_array_equal(ARRAYS["a"], cached(key, never)["a"])


def test_it_can_be_switched_off_or_out_of_reach(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SWITCH, "off")
    assert cached("k", lambda: ARRAYS) is ARRAYS
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(SWITCH, str(tmp_path / "file" / "below"))
    assert cached("k", lambda: ARRAYS) is ARRAYS


def test_keys_tell_inputs_apart() -> None:
    keys = [
        key_of(parts)
        for parts in (["ab"], ["a", "b"], [b"ab", b""], [np.arange(3)], [np.arange(3.0)])
    ]
    assert len(set(keys)) == len(keys)
    assert key_of(["ab"]) == keys[0]


def test_mapped_arrays_are_made_once_and_read_only(folder: Path) -> None:
    mapped(["x"], lambda: ARRAYS)
    again = mapped(["x"], never)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(array, again[name])
        assert array.dtype == again[name].dtype
        assert not again[name].flags.writeable
    other = {"a": np.zeros(3)}
    np.testing.assert_array_equal(mapped(["y"], lambda: other)["a"], other["a"])
    assert not list(folder.glob(".partial*"))


@pytest.mark.parametrize("spoil", ["cut", "empty", "missing", "no names"])
def test_mapped_arrays_that_are_not_whole_are_made_again(folder: Path, spoil: str) -> None:
    mapped(["x"], lambda: ARRAYS)
    file = next(folder.glob("*-a.npy"))
    data = file.read_bytes()
    if spoil == "missing":
        file.unlink()
    elif spoil == "no names":  # another run is about to write them
        next(folder.glob("*.names")).unlink()
    else:
        file.write_bytes(data[: len(data) - 8] if spoil == "cut" else b"")
    made = []
    again = mapped(["x"], lambda: made.append(1) or ARRAYS)  # type: ignore[func-returns-value]
    assert made == [1]
    np.testing.assert_array_equal(ARRAYS["a"], again["a"])
    np.testing.assert_array_equal(ARRAYS["a"], mapped(["x"], never)["a"])


def test_mapped_arrays_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SWITCH, "off")
    assert mapped(["x"], lambda: ARRAYS)["a"] is ARRAYS["a"]
