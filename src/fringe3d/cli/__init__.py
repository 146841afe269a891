"""The command line: read, call, write, print."""

from fringe3d.cli.run import main

__all__ = ["main"]
