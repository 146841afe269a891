"""The command line: read, call, write, print."""

from fringe3d.cli.app import main

__all__ = ["main"]
