"""The command line: read, call, write, print."""

import sys


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; see `fringe3d.cli.run.main`.

    Ctrl-C while the commands are loaded, half a second, is one line, too.
    """
    try:
        from fringe3d.cli.run import main as run
    except KeyboardInterrupt:
        sys.stderr.write("error: interrupted; nothing was written\n")
        exec("")  # as in `fringe3d.cli.run.stop_interrupted`
        sys.exit(130)
    run(arguments)
