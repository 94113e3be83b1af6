"""Every program describes itself with `--help`, and does nothing else."""

import re
import runpy
import subprocess
import sys
from importlib.metadata import distributions
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

ROOT = Path(__file__).resolve().parents[1]
SCREEN = 60
"""Lines."""

INSTALLED = sorted(
    (point.dist.name.replace("-", "_"), point.name)
    for package in distributions()
    if package.name.startswith(("plate-", "plate_"))
    for point in package.entry_points.select(group="console_scripts")
)
SCRIPTS = sorted(
    str(path.relative_to(ROOT))
    for folder in ("bench", "tools", "examples")
    for path in (ROOT / folder).glob("*.py")
    if "__main__" in path.read_text(encoding="utf-8") or folder == "examples"
)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    assert not list(tmp_path.iterdir())  # it has made nothing


def help_text(capsys, monkeypatch, program, run):
    """A program's help. It exits with success, and fits on a screen."""
    monkeypatch.setattr(sys, "argv", [program, "--help"])
    try:
        code = run()
    except SystemExit as end:
        code = end.code
    output, errors = capsys.readouterr()
    assert (code or 0, errors) == (0, "")
    assert output.startswith("usage: ")
    assert 2 < output.count("\n") <= SCREEN
    return output


@pytest.mark.parametrize(("package", "program"), INSTALLED)
def test_a_program_of_a_package(capsys, monkeypatch, package, program):
    points = distributions(name=package)
    (point,) = next(points).entry_points.select(group="console_scripts", name=program)
    path = f"/install/{package}/lib/{package}/{program}"
    text = help_text(capsys, monkeypatch, path, point.load())
    if point.module.endswith("node"):
        assert f"usage: ros2 run {package} {program} " in text
        assert "publishes " in " ".join(text.split()).lower()
        assert "  rig_file           ''           Rig file" in text


@pytest.mark.parametrize("script", SCRIPTS)
def test_each_script_has_help(capsys, monkeypatch, script):
    path = str(ROOT / script)
    monkeypatch.setattr(sys, "path", [str(Path(path).parent), *sys.path])
    help_text(capsys, monkeypatch, path, lambda: runpy.run_path(path, run_name="__main__") and None)


@pytest.mark.parametrize("program", ["calibrate", "teach", "check_rig"])
def test_a_program_without_docstrings(program):
    """PYTHONOPTIMIZE=2 takes them away."""
    package = dict(map(reversed, INSTALLED))[program]
    (point,) = next(distributions(name=package)).entry_points.select(name=program)
    command = f"from {point.module} import main; main()"
    done = subprocess.run(
        [sys.executable, "-OO", "-c", command, "--help"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("usage: ")


def test_no_program_needs_its_docstring():
    """Each splits it only if it is there."""
    folders = ("src/*/plate_*", "bench", "tools", "examples")
    sources = [path for folder in folders for path in ROOT.glob(f"{folder}/**/*.py")]
    split = [path for path in sources if re.search(r"__doc__[.\[]", path.read_text("utf-8"))]
    assert len(sources) > 300
    assert split == []


def test_the_main_programs_are_tested():
    assert {name for _, name in INSTALLED} >= {
        "calibrate", "detector", "device", "driver", "planner", "plate", "simulator", "solver",
    }  # fmt: skip
    assert {"tools/demo.py", "bench/run.py", "examples/own_planner.py"} <= set(SCRIPTS)


def test_a_node_refuses_unknown_arguments(capsys, monkeypatch):
    from plate_sim.node import main

    monkeypatch.setattr(sys, "argv", ["simulator", "sort_4"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert capsys.readouterr().err == (
        "error: argument 'sort_4', allowed: --help, or --ros-args -p NAME:=VALUE ...\n"
    )
