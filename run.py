#!/usr/bin/env python3
"""Set up fringe3d in a virtual environment beside this file, and run one of four jobs.

python3 run.py demo            measure a simulated scan; open demo/result/report.html
python3 run.py test            check style and types, build the docs, and pass all tests
python3 run.py docs            build the docs; open docs/_build/index.html
python3 run.py docs-commands   carry out the commands that README and docs print (half an hour)

Needs Python 3.11 or newer and nothing else.
"""

import hashlib
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ENVIRONMENT = ROOT / ".venv"
SCRIPTS = ENVIRONMENT / ("Scripts" if sys.platform == "win32" else "bin")
DOCS = ("-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "docs", "docs/_build")
COMPILING = ("examples/05_fewer_images.py",)
"""Its machine code is kept: the processes that pass the tests need not all make it."""
PYTHON = SCRIPTS / ("python.exe" if sys.platform == "win32" else "python")


def main(arguments: list[str]) -> int:
    """Run the job named on the command line; return the exit code."""
    if sys.version_info < (3, 11):
        print(f"run.py: expected Python 3.11 or newer, found {sys.version.split()[0]}")
        return 2
    match arguments:
        case ["demo"]:
            set_up(extras="[simulate,view]")
            return call("-m", "fringe3d", "demo", "--out", "demo", "--overwrite")
        case ["test", *options]:
            set_up(extras="[dev]")
            checks = (
                ("-m", "ruff", "check", "."),
                ("-m", "ruff", "format", "--check", "."),
                ("-m", "mypy"),
                DOCS,
                COMPILING,
            )
            if code := call_together(*checks):
                return code
            return call("-m", "pytest", "--numprocesses=auto", "--dist=loadfile",
                        "--durations=40", *options)  # fmt: skip
        case ["docs"]:
            set_up(extras="[dev]")
            return call(*DOCS)
        case ["docs-commands", *pages]:
            set_up(extras="[dev]")
            return call("-m", "benchmarks.docs_commands", *pages)
        case _:
            print(__doc__)
            return 2


def set_up(*, extras: str) -> None:
    """Create the environment and install the project, unless that was done before."""
    wanted = hashlib.sha256(
        (ROOT / "pyproject.toml").read_bytes() + (ROOT / "constraints.txt").read_bytes()
    ).hexdigest()
    stamp = ENVIRONMENT / "installed"
    done = stamp.read_text().split() if stamp.exists() else []
    if f"{wanted}{extras}" in done and PYTHON.exists():
        return
    print("run.py: setting up the environment in .venv (once)", flush=True)
    if not PYTHON.exists():
        try:
            subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True)
        except subprocess.CalledProcessError:
            sys.exit("run.py: cannot create a virtual environment; on Debian or Ubuntu install "
                     "the package python3-venv first")  # fmt: skip
    install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check",
               "--constraint", "constraints.txt", "--editable", f".{extras}"]  # fmt: skip
    if call(*install):
        sys.exit("run.py: the installation failed (see above)")
    kept = [entry for entry in done if entry.startswith(wanted)]
    stamp.write_text("\n".join({*kept, wanted, f"{wanted}{extras}"}))


def call(*arguments: str) -> int:
    """Run the environment's Python in the project folder; return its exit code."""
    return subprocess.run([str(PYTHON), *arguments], cwd=ROOT, check=False).returncode


def call_together(*jobs: tuple[str, ...]) -> int:
    """Run several jobs of the environment's Python at once; return the largest exit code."""
    running = [subprocess.Popen([str(PYTHON), *job], cwd=ROOT) for job in jobs]
    return max(job.wait() for job in running)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
