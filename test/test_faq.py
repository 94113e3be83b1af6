"""The messages that docs/faq.md explains are those of the programs."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/faq.md").read_text(encoding="utf-8")
SHORTEST = 5


def spoken():
    """All literal text of the sources: strings, the pieces of f-strings, and the set-up script."""
    for path in [*ROOT.glob("src/*/plate_*/**/*.py"), *ROOT.glob("tools/**/*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
    yield re.sub(r"\$\w+", "", (ROOT / "tools/setup.sh").read_text(encoding="utf-8"))


def test_every_message_of_the_faq_exists_in_the_code():
    reported = "\n".join(spoken())
    blocks = re.findall(r"^```text\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    assert len(blocks) > 8
    pieces = [piece for block in blocks for piece in re.split(r"\.\.\.|\n", block)]
    pieces = [piece.strip() for piece in pieces if len(piece.strip()) >= SHORTEST]
    assert [piece for piece in pieces if piece not in reported] == []
