"""Kernels: compiled when an included file has changed, once for all clones; no fused operations."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from setuptools import Distribution

import plate_native
from plate_native import CompileKernels, cache, kernels

MODULE = """
#include <Python.h>
#include "value.hpp"
static PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernels", nullptr, -1};
PyMODINIT_FUNC PyInit__kernels() {
    PyObject* m = PyModule_Create(&definition);
    PyModule_AddIntConstant(m, "value", VALUE);
    return m;
}
"""
ALL = ["kernels.cpp", "nb_combined.cpp"]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with one kernel, in the folder that a set-up works in; nothing compiled before, and
    little to compile in place of nanobind."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(plate_native, "DEBIAN", tmp_path / "nanobind")
    (tmp_path / "nanobind/src").mkdir(parents=True)
    (tmp_path / "nanobind/src/nb_combined.cpp").write_text("int nothing;\n")
    monkeypatch.setenv("CXXFLAGS", "-O0")  # in less time
    (tmp_path / "some").mkdir()
    (tmp_path / "some/kernels.cpp").write_text(MODULE)
    (tmp_path / "some/value.hpp").write_text("constexpr int VALUE = 1;\n")
    return tmp_path


def build():
    """Compile. Return the compiled files, and the module's output."""
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
    code += "m = u.module_from_spec(s); s.loader.exec_module(m); print(m.value)"
    words = [sys.executable, "-c", code.format(spec.origin)]
    output = subprocess.run(words, capture_output=True, text=True, check=True)
    return sorted(compiled), int(output.stdout)


def test_only_what_has_changed_is_compiled(package, capfd):
    assert build() == (ALL, 1)
    assert build() == ([], 1)
    (package / "some/value.hpp").write_text("constexpr int VALUE = 2;\n")
    assert build() == (["kernels.cpp"], 2)
    (package / "some/value.hpp").write_text("constexpr int VALUE = nothing;\n")
    with pytest.raises(Exception, match="failed"):
        build()
    assert "nothing" in capfd.readouterr().err


def as_in_another_clone():
    """Keep only the user's part of the compiled files."""
    shutil.rmtree("made")
    next(Path("some").glob("_kernels*.so")).unlink()


def test_another_clone_takes_what_was_compiled(package, monkeypatch):
    assert build() == (ALL, 1)
    as_in_another_clone()
    assert build() == ([], 1)
    (package / "some/value.hpp").write_text("constexpr int VALUE = 2;\n")
    as_in_another_clone()
    assert build() == (["kernels.cpp"], 2)
    monkeypatch.setenv("CXXFLAGS", "-DOTHER")
    as_in_another_clone()
    assert build() == (ALL, 2)


def damage(entry):
    content = bytearray(entry.read_bytes())
    content[len(content) // 2] ^= 1
    entry.write_bytes(content)


def test_a_damaged_cache_entry_is_compiled_again(package):
    build()
    for spoil in (damage, lambda entry: os.truncate(entry, 40), Path.unlink):
        as_in_another_clone()
        for entry in cache.of_user().iterdir():
            spoil(entry)
        assert build() == (ALL, 1)
    as_in_another_clone()
    assert build() == ([], 1)


@pytest.mark.parametrize("place", ["/dev/null", "/proc", "not/absolute"])
def test_without_a_writable_cache_the_build_still_works(package, monkeypatch, place):
    monkeypatch.setenv("XDG_CACHE_HOME", place)
    assert build() == (ALL, 1)
    assert build() == ([], 1)
    assert not Path("not").exists()


def test_a_file_that_is_edited_while_it_is_compiled_is_compiled_again(package, monkeypatch):
    (package / "compiler").write_text(
        f'#!/bin/sh\nc++ "$@" && case "$*" in *some/kernels.cpp*) sleep 0.1; '
        f"echo 'constexpr int VALUE = 2;' > {package}/some/value.hpp;; esac\n"
    )
    (package / "compiler").chmod(0o755)
    monkeypatch.setenv("CXX", str(package / "compiler"))
    assert build() == (ALL, 1)
    assert build() == (["kernels.cpp"], 2)


def test_the_cache_deletes_its_oldest_entries(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "MAX_BYTES", 3 * 132)
    for number in range(4):
        cache.keep(tmp_path, str(number), bytes(100))
        os.utime(tmp_path / str(number), (number, number))
    cache.keep(tmp_path, "last", bytes(100))
    assert {entry.name for entry in tmp_path.iterdir()} == {"2", "3", "last"}


MESSAGES = Path(__file__).parents[2] / "plate_interfaces"


def test_messages_of_another_clone_name_this_one(package):
    """Texts differ, because they have the path of the clone. Compiled files stay as they are."""
    first, second = package / "first", package / "second"
    for clone in (first, second):
        shutil.copytree(MESSAGES, clone / "messages")
    (first / "built/lib").mkdir(parents=True)
    (first / "built/setup.sh").write_text(f"prefix={first}/built\n")
    (first / "built/lib/some.so").write_bytes(bytes(8) + str(first).encode())
    os.utime(first / "built/setup.sh", (1e9, 1e9))

    def call(action, clone):
        return cache.main(action, str(clone / "messages"), str(clone / "built"), str(clone))

    assert call("take", second) == 1
    assert call("keep", first) == 0
    assert call("take", second) == 0
    assert (second / "built/setup.sh").read_text() == f"prefix={second}/built\n"
    assert (second / "built/setup.sh").stat().st_mtime == 1e9  # by which Python knows its bytecode
    assert (second / "built/lib/some.so").read_bytes() == bytes(8) + str(first).encode()
    (second / "messages/msg/Part.msg").write_text("float64 x\n")
    assert call("take", second) == 1
    (second / "built/setup.sh").write_text(f"prefix=include{second}s\n")  # as of a clone at /p
    assert call("keep", second) == 0
    assert call("take", second) == 1


def test_nanobind_that_is_missing_is_named(package, monkeypatch):
    monkeypatch.setattr(plate_native, "DEBIAN", Path("nowhere"))
    with pytest.raises(FileNotFoundError, match="pip install nanobind"):
        build()


@pytest.mark.skipif(shutil.which("objdump") is None, reason="objdump, of g++, is missing")
@pytest.mark.parametrize(
    "package", [path.parent.name for path in sorted(MESSAGES.parent.glob("*/*/kernels.cpp"))]
)
def test_kernels_contain_no_fused_multiply_add(package):
    """GCC may do so in spite of its options; then numbers differ between processors."""
    module = importlib.util.find_spec(f"{package}._kernels").origin
    words = ["objdump", "-d", "--no-show-raw-insn", module]
    code = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "vsqrt" in code or "sqrt" in code  # there are kernels in it
    assert not re.findall(r"\bvfn?m(?:add|sub)\w*", code)


def test_no_kernel_calls_hypot():
    """Its last bit differs between C libraries; test_arm64.py compares results."""
    files = [path for kind in ("*.hpp", "*.cpp") for path in MESSAGES.parent.rglob(kind)]
    assert len(files) > 60
    called = [path.name for path in files if re.search(r"\bhypotf?\(", path.read_text("utf-8"))]
    assert called == []


GUARDED = """
#include <sys/mman.h>
#include <plate/products.hpp>
// n numbers at the end of what may be read.
double* guarded(size_t n) {
    const size_t page = 4096, length = (8 * n + page - 1) / page * page;
    void* all = mmap(nullptr, length + 64 * page, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    mprotect(all, length, PROT_READ | PROT_WRITE);
    return reinterpret_cast<double*>(static_cast<char*>(all) + length) - n;
}
int main() {
    for (int terms : {1, 2, 3, 7, 12, 30})
        for (int high = 1; high <= 20; high++) {
            for (int wide = 1; wide <= 20; wide++)
                plate::product(guarded(terms * high), high, guarded(terms * wide), wide, terms,
                               high, wide, guarded(high * wide), wide);
            plate::square_product(guarded(terms * high), high, terms, high, guarded(high * high));
        }
}
"""


def test_products_read_nothing_beyond_their_matrices(tmp_path):
    """GCC 12 does with vectors of 512 bits: the solver's threads died of it."""
    (tmp_path / "guarded.cpp").write_text(GUARDED)
    include = Path(plate_native.__file__).parent / "include"
    compiler = os.environ.get("CXX", "c++").split()
    words = [*compiler, *plate_native.OPTIONS, f"-I{include}", "guarded.cpp", "-o", "guarded"]
    subprocess.run(words, cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "guarded"], check=True)
