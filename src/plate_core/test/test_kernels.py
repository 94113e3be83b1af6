"""Compiled code follows edits in other files of the package, and only those."""

import os
import subprocess
import sys

import pytest

from plate_core import kernels

ROOM = {
    "__init__.py": "",
    "inner.py": "from plate_core.kernels import kernel\n\n@kernel\ndef one(x):\n    return x + 1\n",
    "outer.py": "from plate_core.kernels import kernel\nfrom .inner import one\n\n"
    "@kernel\ndef two(x):\n    return 2 * one(x)\n",
}
ASK = """
from plate_core.kernels import when_compiling
from plate_rooms.outer import two

told = []
with when_compiling(lambda: told.append("compiling")):
    print(two(3), dict(two.stats.cache_hits))
    two(3.5)  # another kernel: it is said once
assert told == ["compiling"] * (not two.stats.cache_hits)
"""


@pytest.fixture
def ask(tmp_path):
    """Function to what a new process gets from the kernel, and whether it was on disk."""
    package = tmp_path / "plate_rooms"
    package.mkdir()
    for name, text in ROOM.items():
        (package / name).write_text(text)
    paths = [str(tmp_path), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTHONDONTWRITEBYTECODE": "1",
    }

    def ask():
        words = [sys.executable, "-c", ASK]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        value, hits = done.stdout.strip().split(" ", 1)
        return int(value), hits != "{}"

    return package, ask


def test_an_edit_in_another_file_is_followed(ask):
    package, ask = ask
    assert ask() == (8, False)
    assert ask() == (8, True)
    (package / "inner.py").write_text(ROOM["inner.py"].replace("x + 1", "x + 2"))
    assert ask() == (10, False)
    assert ask() == (10, True)


def test_other_packages_keep_numbas_own_stamp():
    class Locator:
        _py_file = __file__

    assert kernels._stamp(Locator()) == kernels._numbas_stamp(Locator())
