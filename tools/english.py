"""Find sentences that readers do not understand at the first reading, by the patterns `PATTERNS`.

    python tools/english.py [FILE ...]

Without arguments, all files of the repository are checked: docstrings, comments and string literals
of Python files, comments of C and C++ files, and Markdown text without code. Exit code 1: a pattern
was found. Each finding is printed as file, line, pattern and text.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

PATTERNS = {
    "name the thing": r"(?:^|[.!] )What (?!if\b)[^?]*\.(?: |$)",
    "write margin, error, delay or distance": r"\b[Bb]y how much\b",
    "write number, duration or fraction": r"(?:^|[.!] )So (?:many|long|much)\b",
    "write except": r"\bbut for\b",
    "write recently or again": r"\bof late\b|\banew\b",
    "write must, or the present tense": r"\b(?:is|are) to be\b",
    "name who requested or reported": r"\bas (?:asked|told|said)\b",
    "write not available": r"\bcannot be had\b",
}
"""Advice to the writer, and the pattern. The table contains only patterns that are wrong in every
sentence."""

SUFFIXES = (".py", ".md", ".hpp", ".cpp", ".c", ".h", ".msg", ".srv", ".action", ".yaml")
"""Name endings of the files that are checked. Tests are not checked."""

EXCEPTIONS = ("tools/english.py",)
"""Files that can contain the patterns."""

COMMENT = re.compile(r"(?:^\s*(?:\*|#)|//|/\*)[*/!]*\s?(.*)")
"""Comment of a line in a file that is neither Python nor Markdown. Code may precede the comment."""


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line number and the text of each docstring, comment and literal of a file."""
    if path.suffix == ".md":
        yield from _paragraphs(path.read_text(encoding="utf-8"))
    elif path.suffix == ".py":
        source = path.read_bytes()
        for token in tokenize.tokenize(io.BytesIO(source).readline):
            if token.type == tokenize.COMMENT:
                yield token.start[0], token.string.lstrip("# ")
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
                for paragraph in re.split(r"\n\s*\n", node.value):
                    yield node.lineno, re.sub(r"\s+", " ", paragraph).strip()
    else:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if comment := COMMENT.search(line):
                yield number, comment[1]


def _paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Yield the paragraphs of a page without code, tables and images."""
    text = re.sub(r"```.*?```", lambda m: "\n" * m.group().count("\n"), text, flags=re.S)
    for number, line in enumerate(text.splitlines(), 1):
        if not re.match(r"\s*(\||!\[|<!--|    )", line):
            yield number, re.sub(r"`[^`]*`", "code", line).strip(" -*#")


def findings(path: Path) -> list[tuple[int, str, str]]:
    """Return line, advice and text of each pattern in a file."""
    return [
        (line, advice, text)
        for line, text in texts(path)
        for advice, pattern in PATTERNS.items()
        if re.search(pattern, text)
    ]


def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(
        prog="tools/english.py",
        description="Find sentences that readers do not understand at the first reading.",
    )
    parser.add_argument(
        "files", nargs="*", help="files to check (default: all files of the repository)"
    )
    return check(parser.parse_args().files)


def check(names: list[str]) -> int:
    """Check files, print the findings, and return the exit code.

    A file that cannot be read counts as a finding. A file whose name ends in .py, but which is not
    valid Python, also counts as a finding.
    """
    if not names:
        names = [name for name in _repository_files() if _is_checked(name)]
    count = 0
    for name in names:
        try:
            found = findings(Path(name))
        except (OSError, SyntaxError, ValueError, RecursionError, tokenize.TokenError) as error:
            print(f"{name}: not readable as {_expected_content(name)}: {error}")
            count += 1
            continue
        for line, advice, text in found:
            print(f"{name}:{line}: {advice}: {text[:160]}")
        count += len(found)
    return 1 if count else 0


def _repository_files() -> list[str]:
    """Return the names of the repository's files. Links and deleted files are omitted."""
    listed = subprocess.run(["git", "ls-files", "-z"], capture_output=True, text=True, check=True)
    names = [name for name in listed.stdout.split("\0") if name]
    return [name for name in names if Path(name).is_file() and not Path(name).is_symlink()]


def _expected_content(name: str) -> str:
    """Return the expected content of a file, for a message."""
    return "Python" if name.endswith(".py") else "UTF-8 text"


def _is_checked(name: str) -> bool:
    """Whether a file of the repository is checked without being named."""
    return name.endswith(SUFFIXES) and "test/" not in name and name not in EXCEPTIONS


if __name__ == "__main__":
    sys.exit(main())
