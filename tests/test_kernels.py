"""Machine code of other sources than those that are here is not used."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from fringe3d.kernels import alongside

INNER = "from numba import njit\n\n@njit(cache=True)\ndef inner():\n    return {}\n"
OUTER = (
    "from numba import njit\nfrom package.inner import inner\n\n"
    "@njit(cache=True)\ndef outer():\n    return inner()\n"
)
SHOW = "from package.outer import outer; print(outer())"
START = (
    "from pathlib import Path\nfrom fringe3d.kernels import forget_stale_kernels\n"
    "forget_stale_kernels(Path(__file__).parent)\n"
)


def run(folder: Path, code: str = SHOW, **environment: str) -> tuple[str, str]:
    """Return what a fresh process prints, and what it prints on standard error."""
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True,
        env=os.environ | environment,
    )  # fmt: skip
    return found.stdout.strip(), found.stderr


def shown(folder: Path, **environment: str) -> str:
    """Return what the compiled function of the package returns in a fresh process."""
    return run(folder, **environment)[0]


def written(folder: Path, start: str) -> Path:
    package = folder / "package"
    package.mkdir()
    (package / "__init__.py").write_text(start)
    (package / "outer.py").write_text(OUTER)
    (package / "inner.py").write_text(INNER.format(1))
    return package


@pytest.mark.parametrize(("start", "second", "elsewhere"), [
    (START, "2", False), (START, "2", True), ("", "1", False)
])  # fmt: skip
def test_changed_source_of_another_file_is_compiled_again(
    tmp_path: Path, start: str, second: str, elsewhere: bool
) -> None:
    """Without the check Numba goes on with the old code: the third case shows the need."""
    package = written(tmp_path, start)
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} if elsewhere else {}
    assert shown(tmp_path, **environment) == "1"
    assert shown(tmp_path, **environment) == "1"
    assert elsewhere == (tmp_path / "cache").exists()
    (package / "inner.py").write_text(INNER.format(2))
    assert shown(tmp_path, **environment) == second


def test_compiling_is_told_once_and_not_where_the_code_is_kept(tmp_path: Path) -> None:
    written(tmp_path, "")
    tell = "from fringe3d.kernels import tell_of_compiling; tell_of_compiling('package')\n"
    code = tell * 2 + SHOW
    assert run(tmp_path, code)[1].count("package: compiling") == 1
    assert run(tmp_path, code)[1] == ""


FORKED = """
import os
import numpy as np
from fringe3d.kernels import over_rows

def fill(out, rows):
    out[rows[0]:rows[1]] += 1

def filled():
    out = np.zeros(64)
    over_rows(fill, 64, out)
    return (out == 1).all()

assert filled()
child = os.fork()
if child == 0:
    os._exit(0 if filled() else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_has_threads_of_its_own(tmp_path: Path) -> None:
    """Those of its parent do not run in it: it would wait for them for ever."""
    found = subprocess.run(
        [sys.executable, "-c", FORKED], cwd=tmp_path, capture_output=True, text=True, check=True,
        env=os.environ | {"NUMBA_NUM_THREADS": "2"}, timeout=120,
    )  # fmt: skip
    assert found.stdout.strip() == "0"


def test_a_call_alongside_takes_one_thread_and_passes_its_error_on() -> None:
    assert alongside(numba.get_num_threads)() == 1
    wait = alongside(int, "no number")
    with pytest.raises(ValueError, match="no number"):
        wait()


def test_calls_alongside_do_not_wait_for_each_other() -> None:
    """More of them than there are threads, each of which begins another one."""
    nested = [alongside(lambda: alongside(sum, [1, 2])()) for _ in range(4 * (os.cpu_count() or 1))]
    assert [wait() for wait in nested] == [3] * len(nested)
