"""Cache of measured results in a file, with a digest of the code from which they were made."""

from __future__ import annotations

import ast
import hashlib
import json
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from harness.result import ROOT
from plate_bringup.identity import code_of_packages, machine

FOLDERS = (ROOT / "bench", ROOT / "tools")
"""Folders of the modules that a measurement can import. `code_of` includes these modules."""


class Cache:
    """Cached results of a measurement, by key. Each result is written at once, so that an
    interrupted measurement can continue.

    Parameters
    ----------
    path : Path
        File with lines of JSON: `code`, `key` and `value`. A line that was not written completely
        is ignored.
    code : str
        Digest of the code of the results. Results with a different digest in the file are ignored.
    """

    def __init__(self, path: Path, code: str) -> None:
        self._path, self._code = path, code
        self._values: dict[str, Any] = {}
        for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
            with suppress(json.JSONDecodeError):
                found = json.loads(line)
                if found["code"] == code:
                    self._values[found["key"]] = found["value"]

    @classmethod
    def of(cls, module: str) -> Cache:
        """Return the cache of a module of this folder: `out/bench/cache/MODULE.jsonl`."""
        return cls(ROOT / f"out/bench/cache/{module}.jsonl", code_of(module))

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __setitem__(self, key: str, value: Any) -> None:
        self._values[key] = value
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            # the line before can be incomplete, for example after the disk was full
            file.write("\n" + json.dumps({"code": self._code, "key": key, "value": value}) + "\n")


@lru_cache
def code_of(module: str) -> str:
    """Return a digest of all files on which a module of a measurement depends.

    The files are those of the installed packages with their compiled kernels, the configuration,
    the module, and the files of `bench` and `tools` that the module imports. The digest also
    includes the versions of the libraries and other facts about the computer (`machine`).
    """
    digest = hashlib.sha256(f"{code_of_packages()} {machine()}".encode())
    for path in sorted(own_files(module)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def own_files(module: str) -> set[Path]:
    """Return a module's file and the files of `bench` and `tools` that it imports, directly or
    indirectly."""
    found: set[Path] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop().replace(".", "/")
        names = (f"{name}.py", f"{name}/__init__.py")
        for path in (folder / file for folder in FOLDERS for file in names):
            if path in found or not path.exists():
                continue
            found.add(path)
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    waiting += [alias.name for alias in node.names]
                elif isinstance(node, ast.ImportFrom) and node.module:
                    waiting += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
    return found
