"""What tests need beyond set-up: says which of it is missing; with --install, installs it.

A test names it, `@pytest.mark.needs("chromium", "plotly")`, and is left out where one of these is
missing (conftest.py).
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REQUIREMENTS = "requirements-test.txt"

PROGRAMS = {
    "chromium": (("chromium", "chromium-browser", "google-chrome"), "chromium"),
    "arm-none-eabi-gcc": (("arm-none-eabi-gcc",), "gcc-arm-none-eabi libnewlib-arm-none-eabi"),
    "qemu-system-arm": (("qemu-system-arm",), "qemu-system-arm"),
}
"""Programs that will do, any of them, and the Debian packages that hold one."""

MODULES = (
    "plotly", "kaleido", "pandas", "tabulate", "numba", "skimage", "gymnasium", "playwright",
    "axe_playwright_python", "can", "canopen", "cantools", "odrive_can",
)  # fmt: skip
"""Of the wheels in `REQUIREMENTS`."""

LAUNCH = "launch_ros"
"""Has no wheel: tools/cli.sh fetches its sources."""


def program(need: str) -> str | None:
    """Return the path of a program that will do."""
    return next(filter(None, map(shutil.which, PROGRAMS[need][0])), None)


def missing() -> list[str]:
    """Return what is not here of all that tests need."""
    modules = [name for name in (*MODULES, LAUNCH) if find_spec(name) is None]
    return [need for need in PROGRAMS if program(need) is None] + modules


def packages(needs: list[str]) -> str:
    """Return the Debian packages that hold these programs, as apt-get takes them."""
    return " ".join(PROGRAMS[need][1] for need in needs if need in PROGRAMS)


def install() -> int:
    """Install what is missing, each by itself; returns 1 if something still is."""
    apt = ["apt-get", "-q", "-y", "-o", "DPkg::Lock::Timeout=300"]
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q", "install"]
    lacking = missing()
    if debian := packages(lacking):
        if os.geteuid() == 0 and shutil.which("apt-get"):
            run([*apt, "update"])
            for need in filter(PROGRAMS.__contains__, lacking):
                run([*apt, "--no-install-recommends", "install", *packages([need]).split()])
        else:
            say(f"not root; type: sudo apt-get install --no-install-recommends {debian}")
    if not run([*pip, "-r", REQUIREMENTS]):  # one of them cannot be had: the others can
        lines = (ROOT / REQUIREMENTS).read_text(encoding="utf-8").splitlines()
        for line in filter(None, (line.split("#")[0].strip() for line in lines)):
            run([*pip, "--only-binary", ":all:", line])
    if LAUNCH in lacking:
        run(["tools/cli.sh"])
    left = missing()
    say(f"cannot be had here: {', '.join(left)}" if left else "all that tests need is here")
    return bool(left)


def run(words: list[str]) -> bool:
    """Run a command; says how long it took, or why it failed."""
    began = time.monotonic()
    env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    done = subprocess.run(
        words, cwd=ROOT, env=env, text=True, check=False,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    command = " ".join([Path(words[0]).name, *words[1:]])
    say(f"{command}: {time.monotonic() - began:.0f} s")
    if done.returncode:
        say("\n".join(done.stdout.splitlines()[-3:]))
    return done.returncode == 0


def say(text: str) -> None:
    print(f"test-tools: {text}", flush=True)


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--install", action="store_true", help="install what is missing")
    if parser.parse_args().install:
        return install()
    if left := missing():
        print(f"Left out for want of {', '.join(left)}: `make test-tools` installs them")
    return 0


if __name__ == "__main__":
    sys.exit(main())
