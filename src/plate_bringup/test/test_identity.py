"""Identity of code: which files belong to a module of others, and which libraries it uses."""

import sys
from pathlib import Path

import numpy as np
import pytest

from plate_bringup.identity import files_of, libraries_of
from plate_core import PlateError

MODULE = """
import os, helper, loose.part
from sub.part import thing
import numpy as np

WEIGHTS = np.load("weights.npz")
MORE = open(os.path.join("data", "table.csv"))
TEXTS = ["", ".", "..", "/etc/hostname", "x" * 300, "line\\nline", "\\0"]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    texts = {
        "other_agent.py": MODULE,
        "helper.py": "open('helped.txt')",
        "helped.txt": "1",
        "sub/__init__.py": "raise SystemExit",
        "sub/part.py": "thing = 1",
        "sub/map.bin": "1",
        "loose/part.py": "",
        "loose/more/table.bin": "1",
        "weights.npz": "1",
        "data/table.csv": "1",
        "data/else.csv": "1",
        "result.json": "1",
        "unused.py": "1",
        "bad.py": "((((",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_files_of_a_module_are_those_that_it_names(folder):
    before = files_of("other_agent")
    assert sorted(before) == [
        "data/table.csv", "helped.txt", "helper.py", "loose/more/table.bin", "loose/part.py",
        "other_agent.py", "sub/__init__.py", "sub/map.bin", "sub/part.py", "weights.npz",
    ]  # fmt: skip
    (folder / "weights.npz").write_text("2", encoding="utf-8")
    after = files_of("other_agent")
    assert {name for name in before if before[name] != after[name]} == {"weights.npz"}


def test_files_of_a_package_are_all_in_its_folder(folder):
    (folder / "sub" / "__pycache__").mkdir()
    (folder / "sub" / "__pycache__" / "part.pyc").touch()
    (folder / "sub" / ".hidden").touch()
    assert sorted(files_of("sub")) == ["sub/__init__.py", "sub/map.bin", "sub/part.py"]


def test_files_of_a_package_without_init_are_those_of_all_its_folders(folder, monkeypatch):
    other = folder / "other"
    (other / "loose").mkdir(parents=True)
    for name in ("part.py", "far.py"):
        (other / "loose" / name).write_text("second", encoding="utf-8")
    before = files_of("loose")
    assert sorted(before) == ["loose/more/table.bin", "loose/part.py"]
    monkeypatch.setattr("sys.path", [*sys.path, str(other)])
    after = files_of("loose")
    assert sorted(after) == ["loose/far.py", "loose/more/table.bin", "loose/part.py"]
    assert after["loose/part.py"] == before["loose/part.py"]


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("weights.npz", 10**13, "module other_agent has 10 files with 1e.07 MB, allowed: at most "),
        ("helper.py", 10**13, r"helper\.py: has 1e.07 MB, allowed: a regular file up to 1 MB"),
    ],
)
def test_sparse_files_of_any_size_are_refused_before_they_are_read(folder, name, size, words):
    with (folder / name).open("wb") as file:
        file.truncate(size)
    with pytest.raises(PlateError, match=words):
        files_of("other_agent")


def test_many_names_and_deep_folders_are_refused(folder, monkeypatch):
    texts = [f"d{k}" for k in range(400)]
    (folder / "wide.py").write_text(f"x = {texts}", encoding="utf-8")
    for name in texts:
        (folder / name).mkdir()
    with pytest.raises(PlateError, match=r"wide\.py: has 400 texts, and 400 of them are names of"):
        files_of("wide")

    def too_deep(*args):
        raise RecursionError

    monkeypatch.setattr(Path, "rglob", too_deep)
    with pytest.raises(PlateError, match="sub: its folders are nested too deeply"):
        files_of("sub")


def test_an_invalid_python_module_counts_as_one_file(folder):
    assert list(files_of("bad")) == ["bad.py"]
    assert libraries_of("bad") == {}


@pytest.mark.parametrize("name", ["no_such_module", "", "sys"])
def test_without_a_file_there_are_no_files(name):
    assert files_of(name) == libraries_of(name) == {}


def test_libraries_are_those_that_are_imported(folder):
    assert libraries_of("other_agent") == {"numpy": np.__version__}
