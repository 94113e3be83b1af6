"""Run the notebook docs/how_it_works.ipynb and write its pictures: docs/how_it_works/NAME.png.

python tools/how_it_works.py [--out FOLDER]

No Jupyter is needed: the cells are plain Python.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
from contextlib import redirect_stdout
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from plate_core import piped

DOCS = Path(__file__).resolve().parents[1] / "docs"
NOTEBOOK = DOCS / "how_it_works.ipynb"


@piped()
def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=DOCS / "how_it_works")
    folder = parser.parse_args().out
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        allowed = "allowed: a folder that can be created"
        sys.exit(f"error: out is {folder}: {problem.strerror}, {allowed}")
    printed, figures = run(code_cells(NOTEBOOK))
    print(printed, end="")
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=100)
        print(folder / f"{name}.png")


def code_cells(notebook: Path) -> list[str]:
    """Return the source of each code cell of a notebook."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def run(cells: list[str]) -> tuple[str, dict[str, Figure]]:
    """Run the cells one after the other. Return the printed output of all cells, and the figures by
    name."""
    names: dict[str, object] = {"__name__": "__main__"}
    printed = io.StringIO()
    with mpl.rc_context(), redirect_stdout(printed):
        for number, source in enumerate(cells, 1):
            exec(compile(source, f"<code cell {number}>", "exec"), names)
    return printed.getvalue(), {name: plt.figure(name) for name in plt.get_figlabels()}


if __name__ == "__main__":
    main()
