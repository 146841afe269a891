"""Machine code of other sources than those that are here is not used."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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


def shown(folder: Path) -> str:
    """Return what the compiled function of the package returns in a fresh process."""
    found = subprocess.run(
        [sys.executable, "-c", SHOW], cwd=folder, capture_output=True, text=True, check=True
    )
    return found.stdout.strip()


@pytest.mark.parametrize(("start", "second"), [(START, "2"), ("", "1")])
def test_changed_source_of_another_file_is_compiled_again(
    tmp_path: Path, start: str, second: str
) -> None:
    """Without the check Numba goes on with the old code: the second case shows the need."""
    package = tmp_path / "package"
    package.mkdir()
    (package / "__init__.py").write_text(start)
    (package / "outer.py").write_text(OUTER)
    (package / "inner.py").write_text(INNER.format(1))
    assert shown(tmp_path) == "1"
    assert shown(tmp_path) == "1"
    (package / "inner.py").write_text(INNER.format(2))
    assert shown(tmp_path) == second
