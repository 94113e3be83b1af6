"""Download the photographs of photographs.yaml to out/photographs/files, and check them.

cd bench && python -m photographs.fetch
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from importlib.util import find_spec
from pathlib import Path
from urllib.error import URLError
from urllib.parse import quote
from urllib.request import urlopen

from photographs.pictures import Photograph, load_photographs
from plate_core import piped

RAW = "https://raw.githubusercontent.com"
"""Base address of files of public GitHub repositories."""

TIMEOUT_S = 30.0
"""Timeout of a request [s]."""


@piped()
def main() -> int:
    """Run the command line, and return its exit code. The exit code is 0 even if pictures are
    missing."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    photographs = load_photographs()
    present = 0
    for photograph in photographs:
        problem = fetch_photograph(photograph)
        if problem:
            print(f"missing: {photograph.name}: {problem}", file=sys.stderr)
        present += not problem
    print(f"{present} of {len(photographs)} photographs are on this computer")
    return 0


def fetch_photograph(photograph: Photograph) -> str:
    """Download one file if it is missing. Return an error text, empty if there was no error."""
    path = photograph.file
    if is_there(photograph):
        return ""
    try:
        content = _read_photograph(photograph)
    except (OSError, URLError) as problem:
        return " ".join(str(problem).split()) or type(problem).__name__
    digest = hashlib.sha256(content).hexdigest()
    if digest != photograph.sha256:
        return f"sha256 is {digest[:12]}..., allowed: {photograph.sha256[:12]}..."
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".draft")
    draft.write_bytes(content)
    draft.replace(path)
    return ""


def is_there(photograph: Photograph) -> bool:
    """Whether a photograph's file exists and has the right digest."""
    path = photograph.file
    return path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() == photograph.sha256


def _read_photograph(photograph: Photograph) -> bytes:
    """Return the content of a photograph's file, from an installed package or from the network."""
    source = photograph.source
    if "package" in source:
        spec = find_spec(source["path"].split("/", maxsplit=1)[0])
        if spec is None or spec.origin is None:
            raise FileNotFoundError(f"package {source['package']} is not installed")
        return (Path(spec.origin).parents[1] / source["path"]).read_bytes()
    url = f"{RAW}/{source['github']}/{source['commit']}/{quote(source['path'])}"
    with urlopen(url, timeout=TIMEOUT_S) as answer:
        return bytes(answer.read())


if __name__ == "__main__":
    sys.exit(main())
