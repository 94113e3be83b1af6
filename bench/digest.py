"""What a measurement depends on, as a digest: unchanged, it need not be made again."""

from __future__ import annotations

import ast
import hashlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def code_of(name: str) -> str:
    """Return a digest of all that a measurement depends on: `src`, `config`, and its own files."""
    return code_of_module(f"measure_{name}")


def code_of_module(module: str) -> str:
    """Return the same of any module of this folder."""
    digest = hashlib.sha256()
    for folder in (ROOT / "src", ROOT / "config"):
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder).parts
            if path.suffix in (".py", ".yaml") and "test" not in inside:
                digest.update(path.read_bytes())
    for path in sorted(own_files(module)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def own_files(module: str) -> set[Path]:
    """Return the files of this folder that a module of it imports, itself among them."""
    found: set[Path] = set()
    open_ = [module]
    while open_:
        path = ROOT / "bench" / f"{open_.pop()}.py"
        if path in found or not path.exists():
            continue
        found.add(path)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                open_ += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                open_.append(node.module)
    return found
