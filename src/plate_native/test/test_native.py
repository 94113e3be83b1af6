"""Kernels: compiled when what they include has changed, without instructions that fuse."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from setuptools import Distribution

import plate_native
from plate_native import CompileKernels, kernels

MODULE = """
#include <plate/bind.hpp>
#include "value.hpp"
NB_MODULE(_kernels, m) { m.def("value", [] { return VALUE; }); }
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with one kernel, in the folder that a set-up works in."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CXXFLAGS", "-O0")  # in less time
    (tmp_path / "some").mkdir()
    (tmp_path / "some/kernels.cpp").write_text(MODULE)
    (tmp_path / "some/value.hpp").write_text("constexpr int VALUE = 1;\n")
    return tmp_path


def build():
    """Compile; returns what was compiled, and what the module says."""
    command = CompileKernels(Distribution({"name": "some", "ext_modules": [kernels("some")]}))
    command.inplace, command.build_temp = True, "made"
    command.finalize_options()
    compiled, spawn = [], command.spawn
    command.spawn = lambda words: (
        compiled.append(Path(words[-3]).name) if "-c" in words else None,
        spawn(words),
    )
    command.run()
    spec = importlib.util.spec_from_file_location("_kernels", *Path("some").glob("_kernels*.so"))
    code = "import importlib.util as u; s = u.spec_from_file_location('_kernels', {!r}); "
    code += "m = u.module_from_spec(s); s.loader.exec_module(m); print(m.value())"
    words = [sys.executable, "-c", code.format(spec.origin)]
    said = subprocess.run(words, capture_output=True, text=True, check=True)
    return sorted(compiled), int(said.stdout)


def test_only_what_has_changed_is_compiled(package, capfd):
    assert build() == (["kernels.cpp", "nb_combined.cpp"], 1)
    assert build() == ([], 1)
    (package / "some/value.hpp").write_text("constexpr int VALUE = 2;\n")
    assert build() == (["kernels.cpp"], 2)
    (package / "some/value.hpp").write_text("constexpr int VALUE = nothing;\n")
    with pytest.raises(Exception, match="failed"):
        build()
    assert "nothing" in capfd.readouterr().err


def test_nanobind_that_is_missing_is_named(package, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(plate_native, "DEBIAN", Path("nowhere"))
    with pytest.raises(FileNotFoundError, match="pip install nanobind"):
        build()


@pytest.mark.skipif(shutil.which("objdump") is None, reason="objdump, of g++, is missing")
@pytest.mark.parametrize("package", ["plate_sim", "plate_solver", "plate_vision"])
def test_no_product_is_fused_with_a_sum(package):
    """GCC may do so in spite of its options; then numbers differ between processors."""
    module = importlib.util.find_spec(f"{package}._kernels").origin
    words = ["objdump", "-d", "--no-show-raw-insn", module]
    code = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "vsqrt" in code or "sqrt" in code  # there are kernels in it
    assert not re.findall(r"\bvfn?m(?:add|sub)\w*", code)
