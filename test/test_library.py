"""`pip install .`: the cores of all stages as a library, with their data, without ROS."""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

USE = """
import sys
sys.modules["rclpy"] = None  # importing it fails
import plate_core, plate_driver.setpoints, plate_planner, plate_sim, plate_solver, plate_vision
import plate_bringup.loop, plate_bringup.production
from plate_core.tasks import load_scenario, scenario_names
from plate_driver.transports import check_transport
check_transport("serial", "/dev/some")
plate_planner.Planner(plate_core.load_rig(), load_scenario("sort_10"))
print(plate_core.__file__, len(scenario_names()))
"""


def test_the_library_is_installed_with_its_data_and_needs_no_ros(tmp_path):
    source, target = tmp_path / "a clone", tmp_path / "installed"
    for name in ("src", "config", "firmware"):
        skip = shutil.ignore_patterns("test", "__pycache__", "build", "*.egg-info")
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=skip)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, source)
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "install",
        "-q",
        "--no-compile",
    ]
    subprocess.run(  # kernels that set-up has compiled are taken
        [*pip, "--no-build-isolation", "--no-deps", "--no-index", "--target", target, source],
        check=True, timeout=300,
    )  # fmt: skip
    variables = os.environ | {"PYTHONPATH": str(target), "AMENT_PREFIX_PATH": ""}
    done = subprocess.run(
        [sys.executable, "-c", USE],
        env=variables, cwd=tmp_path, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    shipped = len(list((ROOT / "config/scenarios").glob("*.yaml")))
    assert done.stdout == f"{target}/plate_core/__init__.py {shipped}\n"


def test_the_requirements_equal_those_of_the_packages():
    """Each package can also be installed alone; together their requirements are those of the
    whole."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    whole, parts = settings["project"], settings["tool"]["setuptools"]["packages"]["find"]["where"]
    requested, versions = set(), set()
    for path in ROOT.glob("src/*/setup.py"):
        text = path.read_text(encoding="utf-8")
        if str(path.parent.relative_to(ROOT)) in parts:
            requested |= set(eval(text.split("install_requires=")[1].split("]")[0] + "]"))
        versions.add(text.split('version="')[1].split('"')[0])
    assert requested - {"plate_core"} == set(whole["dependencies"])
    assert versions == {whole["version"]}
