"""Install the wheels of tools that only some tests need, and list the missing tools.

--install also installs the programs, the browser's driver and ROS's launch. A test names its tools
with `@pytest.mark.needs("chromium", "plotly")`. conftest.py omits the test if a tool is missing.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WHEELS = "requirements-test.txt"
BROWSER_WHEELS = "requirements-browser.txt"
SIZES = {
    WHEELS: "190 MB to download, 730 MB on disk",
    BROWSER_WHEELS: "54 MB to download, 175 MB on disk",
}

PROGRAMS = {
    "chromium": (("chromium", "chromium-browser", "google-chrome"), "chromium"),
    "arm-none-eabi-gcc": (("arm-none-eabi-gcc",), "gcc-arm-none-eabi libnewlib-arm-none-eabi"),
    "qemu-system-arm": (("qemu-system-arm",), "qemu-system-arm"),
    "aarch64-linux-gnu-g++": (("aarch64-linux-gnu-g++",), "g++-aarch64-linux-gnu"),
    "qemu-aarch64": (("qemu-aarch64", "qemu-aarch64-static"), "qemu-user"),
}
"""For each tool, its alternative program names and the Debian packages that contain it."""

MODULES = (
    "plotly", "kaleido", "pandas", "tabulate", "numba", "skimage", "gymnasium", "distributed",
    "playwright", "axe_playwright_python", "can", "canopen", "cantools", "odrive_can",
)  # fmt: skip
"""Import names of the packages in the requirements files `WHEELS` and `BROWSER_WHEELS`."""

LAUNCH = "launch_ros"
"""Import name of a package without a wheel. tools/cli.sh fetches its sources."""


def program(need: str) -> str | None:
    """Return the path of a tool's program, or None if the program is not installed."""
    return next(filter(None, map(shutil.which, PROGRAMS[need][0])), None)


def missing() -> list[str]:
    """Return the tools that tests need and that are not installed."""
    modules = [name for name in (*MODULES, LAUNCH) if find_spec(name) is None]
    return [need for need in PROGRAMS if program(need) is None] + modules


def packages(needs: list[str]) -> str:
    """Return the names of the Debian packages of the given tools, separated by spaces."""
    return " ".join(PROGRAMS[need][1] for need in needs if need in PROGRAMS)


def pins(requirements: str) -> list[str]:
    """Return the pins "name==version" in a requirements file."""
    lines = (ROOT / requirements).read_text(encoding="utf-8").splitlines()
    return [pin for line in lines if "==" in (pin := line.partition("#")[0].strip())]


def is_installed(pin: str) -> bool:
    """Return whether a package is installed in the pinned version."""
    name, _, pinned = pin.partition("==")
    try:
        return version(name) == pinned
    except PackageNotFoundError:
        return False


def install_wheels(requirements: str) -> bool:
    """Install a requirements file unless all its pins are installed. Return whether this
    succeeded."""
    if all(map(is_installed, pins(requirements))):
        return True
    report(f"installing {requirements} ({SIZES[requirements]})")
    return run([sys.executable, "tools/install.py", "-r", requirements])


def install() -> int:
    """Install all missing tools, each separately. Return 1 if a tool is still missing."""
    apt = ["apt-get", "-q", "-y", "-o", "DPkg::Lock::Timeout=300"]
    lacking = missing()
    if debian := packages(lacking):
        if os.geteuid() == 0 and shutil.which("apt-get"):
            run([*apt, "update"])
            for need in filter(PROGRAMS.__contains__, lacking):
                run([*apt, "--no-install-recommends", "install", *packages([need]).split()])
        else:
            report(f"not root; type: sudo apt-get install --no-install-recommends {debian}")
    for requirements in (WHEELS, BROWSER_WHEELS):
        # if one package version is not available, install the other packages one by one
        if not install_wheels(requirements):
            for pin in pins(requirements):
                run([sys.executable, "tools/install.py", "--only-binary", ":all:", pin])
    if LAUNCH in lacking:
        run(["tools/cli.sh"])
    left = missing()
    report(
        f"not available on this machine: {', '.join(left)}" if left else "all tools are installed"
    )
    return bool(left)


def run(command_line: list[str]) -> bool:
    """Run a command, and print its duration, and the end of its output if it failed. Return whether
    it succeeded."""
    began = time.monotonic()
    env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    done = subprocess.run(
        command_line, cwd=ROOT, env=env, text=True, check=False,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    command = " ".join([Path(command_line[0]).name, *command_line[1:]])
    report(f"{command}: {time.monotonic() - began:.0f} s")
    if done.returncode:
        report("\n".join(done.stdout.splitlines()[-3:]))
    return done.returncode == 0


def report(text: str) -> None:
    print(f"test-tools: {text}", flush=True)


def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--install", action="store_true", help="install all tools")
    if parser.parse_args().install:
        return install()
    install_wheels(WHEELS)
    if left := missing():
        report(f"tests that need {', '.join(left)} are skipped: `make test-tools` installs these")
    return 0


if __name__ == "__main__":
    sys.exit(main())
