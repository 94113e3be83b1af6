"""Install Python packages into .venv: python tools/install.py [arguments of `pip install`]

If uv is installed, it installs the packages about five times faster than pip. Without a network, uv
installs from its cache. This program passes the settings of pip to uv. If uv fails, pip is used.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input"]
FROM_PIP = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "constraint": "UV_CONSTRAINT",
    "no-index": "UV_NO_INDEX",
    "cert": "SSL_CERT_FILE",
    "proxy": "ALL_PROXY",
}
"""Settings of pip, and the environment variable of uv for each setting."""

ELSEWHERE = ("UV_PREFIX", "UV_PYTHON", "UV_SYSTEM_PYTHON", "UV_TARGET")
"""Environment variables that would make uv install outside .venv."""


def settings() -> dict[str, str]:
    """Return pip's settings as environment variables of uv. Missing folders are omitted, as pip
    does."""
    listed = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True, check=False)
    # with this setting, uv gives all package indexes the same priority, as pip does
    found = {"UV_INDEX_STRATEGY": "unsafe-best-match"}
    # pip lists the settings from environment variables before those from files. The first value of
    # a setting is used.
    for line in listed.stdout.splitlines():
        name, _, value = line.partition("=")
        key = name.rpartition(".")[2]
        if key in FROM_PIP:
            places = str(ast.literal_eval(value)).split()
            present = [word for word in places if not _is_missing(word.removeprefix("file://"))]
            found.setdefault(FROM_PIP[key], ("," if key == "find-links" else " ").join(present))
    return found


def _is_missing(place: str) -> bool:
    return place.startswith("/") and not Path(place).exists()


def main(arguments: list[str]) -> int:
    """Install packages with the arguments of `pip install`. Return the exit code."""
    if find_spec("uv"):
        uv = [sys.executable, "-m", "uv", "pip", "install", "-q", "--python", sys.executable]
        # compile the modules now, because in this case Python does not store compiled modules
        if sys.dont_write_bytecode:
            uv.append("--compile-bytecode")
        inherited = {name: value for name, value in os.environ.items() if name not in ELSEWHERE}
        for where in (["--offline"], []):
            command, env = [*uv, *where, *arguments], {**settings(), **inherited}
            done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                return 0
        print(f"{done.stderr}uv failed, so pip installs the packages", file=sys.stderr)
    return subprocess.run([*PIP, "install", "-q", *arguments], check=False).returncode


if __name__ == "__main__":
    usage = "%(prog)s [arguments of `pip install`]"
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0], usage=usage)
    sys.exit(main(parser.parse_known_args()[1]))
