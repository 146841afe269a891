"""Put what ``fringe3d evaluate paper --out FOLDER`` left into docs/paper.md and docs/images.

    fringe3d evaluate paper --out paper
    python docs/paper_tables.py paper

Everything between the two marks in docs/paper.md is replaced.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

DOCS = Path(__file__).parent
START, END = "<!-- printed -->", "<!-- end of printed -->"
PICTURES = {"overview.png": "paper-overview.png", "errors-machine-part.png": "paper-errors.png"}


def main(folder: Path) -> None:
    """Replace the tables of the page, and its pictures."""
    printed = (folder / "paper.md").read_text(encoding="utf-8").split("\n", 1)[1].strip()
    printed = printed.replace("\n## ", "\n### ")
    for name, kept in PICTURES.items():
        shutil.copyfile(folder / name, DOCS / "images" / kept)
        printed = printed.replace(f"({name})", f"(images/{kept})")
    page = DOCS / "paper.md"
    before, rest = page.read_text(encoding="utf-8").split(START)
    after = rest.split(END)[1]
    page.write_text(f"{before}{START}\n\n{printed}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
