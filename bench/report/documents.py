"""Tables of measurements in handwritten pages.

A table is written between `<!-- measured: NAME TABLE -->` and `<!-- end -->`. If TABLE is
`summary`, the sentences of the measurement are written instead of a table."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from harness import ROOT
from report.chart import Data
from report.page import cell_texts, common_commit, measured

DOCUMENTS = ("README.md", "docs/graph.md", "docs/guide/rig.md", "docs/guide/trust.md")

BLOCK = re.compile(r"(<!-- measured: (\w+) (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def names() -> Iterable[str]:
    """Yield the names of the measurements whose tables are in the documents."""
    for name in DOCUMENTS:
        for block in BLOCK.finditer((ROOT / name).read_text(encoding="utf-8")):
            yield block[2]


def fill_documents(data: Data, facts: Data, root: Path = ROOT) -> None:
    """Write the tables of the available measurements into the documents below a folder."""
    commit = common_commit(facts)

    def replace_block(block: re.Match[str]) -> str:
        before, name, key, after = block.groups()
        if name not in data:
            return block[0]
        return before + block_text(name, data[name], key, facts, commit) + after

    for name in DOCUMENTS:
        path = root / name
        old = path.read_text(encoding="utf-8")
        new = BLOCK.sub(replace_block, old)
        if new != old:
            path.write_text(new, encoding="utf-8")


def block_text(name: str, item: Mapping[str, Any], key: str, facts: Data, commit: str) -> str:
    """Return the text of a table, or of the sentences."""
    if key == "summary":
        return "".join(f"- {line}\n" for line in item["summary"])
    table = next(candidate for candidate in item["tables"] if candidate["key"] == key)
    frame = pd.DataFrame(table["rows"], columns=list(table["columns"])).rename(
        columns=table["columns"]
    )
    lines = cell_texts(frame).to_markdown(index=False, disable_numparse=True)
    how = f"`make bench ARGS={name}` repeats the measurement"
    note = f"{table['note']} {how}{measured(facts.get(name), commit)}."
    return f"{lines}\n\n*{note.strip()}*\n"
