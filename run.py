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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ENVIRONMENT = ROOT / ".venv"
SCRIPTS = ENVIRONMENT / ("Scripts" if sys.platform == "win32" else "bin")
DOCS = ("-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "docs", "docs/_build")
COMPILING = ("examples/05_fewer_images.py",)
"""Its machine code is kept: the processes that pass the tests need not all make it."""
INSTALL = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile",
           "--constraint", "constraints.txt")  # fmt: skip
"""Python compiles what is imported; compiling all takes as long as the rest of the installation."""
PYTHON = SCRIPTS / ("python.exe" if sys.platform == "win32" else "python")


def main(arguments: list[str]) -> int:
    """Run the job named on the command line; return the exit code."""
    if sys.version_info < (3, 11):
        print(f"run.py: expected Python 3.11 or newer, found {sys.version.split()[0]}")
        return 2
    match arguments:
        case ["demo"]:
            set_up(extras="[simulate]")
            with added(extra="view"):  # meanwhile: the demo does not need it
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
    wanted = wanted_now()
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
    install = (*INSTALL, "--editable", f".{extras}")
    if call(*install):
        sys.exit("run.py: the installation failed (see above)")
    note(f"{wanted}{extras}")


@contextmanager
def added(*, extra: str) -> Iterator[None]:
    """Install what an extra needs while something else goes on, unless that was done before."""
    entry = f"{wanted_now()}[{extra}]"
    if entry in (ENVIRONMENT / "installed").read_text().split():
        yield
        return
    import tomllib  # not known to the older Pythons that `main` refuses

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = project["optional-dependencies"][extra]
    with subprocess.Popen([str(PYTHON), *INSTALL, *needed], cwd=ROOT) as installing:
        yield
    if installing.returncode:
        sys.exit("run.py: the installation failed (see above)")
    note(entry)


def wanted_now() -> str:
    """Return a name of what is to be installed."""
    wanted = (ROOT / "pyproject.toml").read_bytes() + (ROOT / "constraints.txt").read_bytes()
    return hashlib.sha256(wanted).hexdigest()


def note(entry: str) -> None:
    """Note that something of what is wanted now is installed."""
    stamp, wanted = ENVIRONMENT / "installed", wanted_now()
    done = stamp.read_text().split() if stamp.exists() else []
    kept = [old for old in done if old.startswith(wanted)]
    stamp.write_text("\n".join({*kept, wanted, entry}))


def call(*arguments: str) -> int:
    """Run the environment's Python in the project folder; return its exit code."""
    return subprocess.run([str(PYTHON), *arguments], cwd=ROOT, check=False).returncode


def call_together(*jobs: tuple[str, ...]) -> int:
    """Run several jobs of the environment's Python at once; return the largest exit code."""
    running = [subprocess.Popen([str(PYTHON), *job], cwd=ROOT) for job in jobs]
    return max(job.wait() for job in running)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
