"""Kernels on arm64: all compile without a warning, and return what they return here.

The programs in the folder arm64 call kernels with random inputs. Their results also depend on sin,
log and others of the C library, whose code for arm64 is that for x86-64 with FMA. Compiling takes a
minute of one core, so the results are kept where kernels are.
"""

import math
import os
import subprocess
import sys
import sysconfig
from array import array
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from needs import program

from plate_native import OPTIONS, WARNINGS, _nanobind, cache

ROOT = Path(__file__).resolve().parents[3]
SHARED = ROOT / "src/plate_native/plate_native/include"
NANOBIND = _nanobind()
CROSS = "aarch64-linux-gnu-g++"
DRAWS = 6
"""Random inputs of each program. QEMU computes 4 in a second, at the least."""


def made(compiler, source, package, place, *options, system=()):
    """Return the file that a compiler makes of a source; fail if it prints warnings or errors."""
    folders = (package, SHARED, source.parent)
    own = {path for folder in folders for path in folder.rglob("*.[hc]pp")}
    own |= {*ROOT.glob("firmware/*.[hc]"), NANOBIND / "include/nanobind/nanobind.h"}
    words = [*compiler, *OPTIONS, *WARNINGS, "-Wno-psabi", *options]
    contents = [path.read_bytes() for path in (source, *sorted(own))]
    key = cache.key_of(cache.compiler(words), sys.version, *options, *contents)
    target = place / f"{Path(compiler[0]).name}-{package.name}-{source.parent.name}-{source.stem}"
    kept = cache.take(cache.of_user(), key)
    if kept is None:
        words += [f"-I{package}", f"-I{SHARED}", *(f"-isystem{folder}" for folder in system)]
        words += [str(source), "-o", str(target)]
        target.write_text("compiles")  # stays with -fsyntax-only
        done = subprocess.run(words, capture_output=True, text=True)
        assert (done.stderr, done.returncode) == ("", 0)
        cache.keep(cache.of_user(), key, target.read_bytes())
    else:
        target.write_bytes(kept)
        target.chmod(0o755)
    return target


@pytest.mark.needs(CROSS)
def test_all_kernels_compile_for_arm64(tmp_path):
    # Debian's Python looks for its settings by the processor.
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    settings = tmp_path / "aarch64-linux-gnu" / version / "pyconfig.h"
    settings.parent.mkdir(parents=True)
    settings.write_text(f'#include "{sysconfig.get_config_h_filename()}"\n')
    system = [sysconfig.get_path("include"), tmp_path, NANOBIND / "include"]
    system.append(NANOBIND / "ext/robin_map/include")
    packages = [path.parent for path in ROOT.glob("src/*/*/kernels.cpp")]
    sources = [(path, package) for package in packages for path in package.rglob("*.cpp")]
    assert len(sources) >= 22

    def compiled(source, package):
        made([CROSS], source, package, tmp_path, "-fsyntax-only", system=system)

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        list(pool.map(compiled, *zip(*sources, strict=True)))  # code is made in the next test


@pytest.mark.needs(CROSS, "qemu-aarch64")
def test_kernels_return_the_same_on_arm64(tmp_path):
    """To the last bit."""
    native, compared = os.environ.get("CXX", "c++").split(), {}
    for source in sorted(Path(__file__).parent.glob("arm64/*.cpp")):
        package = ROOT / f"src/plate_{source.stem}/plate_{source.stem}"
        cross = made([CROSS], source, package, tmp_path, "-static", "-s")
        programs = ([made(native, source, package, tmp_path)], [program("qemu-aarch64"), cross])
        commands = [[*words, str(DRAWS)] for words in programs]
        done = [subprocess.run(words, capture_output=True, check=True) for words in commands]
        here, there = (array("d", one.stdout) for one in done)
        assert all(map(math.isfinite, here))
        differ = [(x, y) for x, y in zip(here, there, strict=True) if x.hex() != y.hex()]
        assert (source.stem, differ) == (source.stem, [])
        compared[source.stem] = len(here)
    assert len(compared) == 4
    assert min(compared.values()) > 30 * DRAWS, compared
