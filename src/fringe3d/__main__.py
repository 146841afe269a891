"""``python -m fringe3d``: the command line."""

from fringe3d.cli import main

main()
