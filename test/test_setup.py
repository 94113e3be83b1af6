"""Set-up, as far as it goes without an installation."""

import fcntl
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import needs
import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PREFIX = "Programming Language :: Python :: "
PYTHONS = [name.removeprefix(PREFIX) for name in PROJECT["classifiers"] if PREFIX in name]


def test_a_set_up_reports_that_it_waits_for_another_one(tmp_path):
    script = tmp_path / "tools" / "setup.sh"
    script.parent.mkdir()
    script.write_text((ROOT / "tools" / "setup.sh").read_text())
    environment = os.environ | {"ROS_DISTRO": "foxy"}  # refused as soon as the wait is over
    with script.open() as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        process = subprocess.Popen(
            ["bash", script, "--quiet"], env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        output = process.stdout.readline()
        assert process.poll() is None
    rest, errors = process.communicate(timeout=60)
    assert (output, rest) == ("set-up: waiting for another set-up of this folder to end\n", "")
    assert "ROS 'foxy' is sourced" in errors


def test_set_up_reports_the_progress_of_a_step(tmp_path):
    script = (ROOT / "tools" / "setup.sh").read_text()
    functions = script[script.index("say() {") : script.index("trap ")]
    (tmp_path / "log").write_text("[1/3] one\n[2/3] two\n-- no count\n")
    words = "set -euo pipefail; root=. busy= telling= counted= log=log\n"
    words += "sleep() { command sleep 0.1; }\n"
    words += functions + 'step "compiling all"; read -r; end_group "$telling"'
    process = subprocess.Popen(
        ["bash", "-c", words], cwd=tmp_path, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    output = [process.stdout.readline() for _ in range(3)]
    errors = process.communicate("go on\n", timeout=60)[1]
    assert output[0] == "set-up: [0 s] compiling all\n"
    assert all(line.endswith(" s] still compiling [2/3]\n") for line in output[1:])
    assert (process.returncode, errors) == (0, "")


def test_on_another_processor_it_advises_at_once_to_install_ros(tmp_path):
    script = (ROOT / "tools" / "setup.sh").read_text()
    functions = script[script.index("say() {") : script.index("trap ")]
    functions += script[script.index("choose_ros() {") : script.index("# A name on the PATH")]
    for machine, distro, code in (
        ("aarch64", "", 1), ("aarch64", "jazzy", 0), ("x86_64", "jazzy", 0)
    ):  # fmt: skip
        words = f"uname() {{ echo {machine}; }}; {functions} choose_ros; echo $ros"
        environment = os.environ | {"ROS_DISTRO": distro}
        command = ["bash", "-c", words.replace("/opt/ros/jazzy", str(tmp_path))]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert (done.returncode, done.stdout) == (code, f"{distro}\n" if distro else "")
        assert ("this machine is aarch64" in done.stderr) is bool(code)


def test_wheels_of_tests_are_installed_once_and_their_size_is_given_before(
    tmp_path, monkeypatch, capsys
):
    commands: list[list[str]] = []
    monkeypatch.setattr(needs, "ROOT", tmp_path)

    def run(words):
        commands.append(words)
        return True

    monkeypatch.setattr(needs, "run", run)
    installed = f"-c constraints.txt\npytest=={pytest.__version__}  # it\n"
    (tmp_path / needs.WHEELS).write_text(installed)
    assert needs.install_wheels(needs.WHEELS)
    assert (commands, capsys.readouterr().out) == ([], "")
    for pin in ("pytest==0.0.1", "no-such-package==1.0"):
        (tmp_path / needs.WHEELS).write_text(f"{pin}\n")
        assert needs.install_wheels(needs.WHEELS)
        assert commands.pop()[1:] == ["tools/install.py", "-r", needs.WHEELS]
        assert "190 MB to download" in capsys.readouterr().out


def test_each_module_that_tests_need_is_of_a_pinned_wheel():
    wheels = [pin for file in (needs.WHEELS, needs.BROWSER_WHEELS) for pin in needs.pins(file)]
    names = {pin.partition("==")[0].replace("-", "_").lower() for pin in wheels}
    by_module = {"skimage": "scikit_image", "can": "python_can"}
    assert {by_module.get(module, module) for module in needs.MODULES} <= names


def test_versions_of_python_are_named_once():
    """In pyproject.toml; set-up reads them there, and all other texts name none."""
    assert PROJECT["requires-python"] == f">={PYTHONS[0]}"
    assert sorted(PYTHONS, key=lambda name: int(name[2:])) == PYTHONS
    folders = (".ci", "bench", "config", "docs", "examples", "firmware", "src", "test", "tools")
    files = [path for path in ROOT.iterdir() if path.is_file() and path.name != "CHANGELOG.md"]
    files += [path for folder in folders for path in (ROOT / folder).rglob("*")]
    kinds = {"", ".cff", ".cfg", ".md", ".py", ".sh", ".toml", ".txt", ".xml", ".yaml", ".yml"}
    written = re.compile(r"python[ -]?\(?3\.\d+\b(?!\.)|\bpy3\d+\b|\bcp3\d+\b", re.IGNORECASE)
    found = {
        (str(path.relative_to(ROOT)), match)
        for path in files
        if path.suffix in kinds and path.is_file() and "build" not in path.parts
        for match in written.findall(path.read_text(encoding="utf-8"))
    }
    assert found == set()


COMMANDS = (
    "bash cat chmod cp dirname env flock grep mkdir mktemp rm sed sha256sum sleep touch uname"
)
NO_VENV = """#!/bin/sh
case "$2" in *version_info*) echo VERSION ;; *) exit 1 ;; esac
"""
NO_HEADERS = """#!/bin/sh
case "$2" in
    *version_info*) echo VERSION ;;
    *get_path*) echo /nowhere/Python.h ;;
    venv) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
    *_base_executable*) echo "$0" ;;
esac
"""


@pytest.mark.parametrize("version", PYTHONS)
@pytest.mark.parametrize(
    ("python", "lacking"),
    [
        (NO_VENV, "Python VERSION is here, but without the module that makes virtual environments"),
        (NO_HEADERS, "this is missing: the compiler g++, /nowhere/Python.h"),
        (None, f"Python {PYTHONS[0]} to {PYTHONS[-1]} is needed. Tried: "),
    ],
)
def test_on_a_bare_machine_it_names_all_packages_in_one_screen(tmp_path, version, python, lacking):
    """Each of Debian 12 and 13, Ubuntu 24.04 and 26.04 has one of these Pythons as python3."""
    clone, programs = tmp_path / "clone", tmp_path / "bin"
    (clone / "tools").mkdir(parents=True)
    programs.mkdir()
    shutil.copy(ROOT / "pyproject.toml", clone)
    script = (ROOT / "tools" / "setup.sh").read_text().replace("/opt/ros/jazzy", str(tmp_path))
    script = script.replace("/usr/bin/python3", str(tmp_path / "no-python"))
    (clone / "tools" / "setup.sh").write_text(script)
    for name in COMMANDS.split():
        (programs / name).symlink_to(shutil.which(name))
    own = {"id": "#!/bin/sh\necho 1000\n", "python3": python}  # not root, who installs them
    for name, text in own.items():
        if text:
            (programs / name).write_text(text.replace("VERSION", version))
            (programs / name).chmod(0o755)
    done = subprocess.run(
        ["bash", "tools/setup.sh", "--quiet"], cwd=clone, text=True, capture_output=True,
        env={"PATH": str(programs), "HOME": str(tmp_path)},
    )  # fmt: skip
    expected = version if python else "3"
    line = f"sudo apt install g++ python{expected}-dev python{expected}-venv"
    assert lacking.replace("VERSION", version) in done.stderr
    assert line in done.stderr
    assert done.returncode == 1
    assert len((done.stdout + done.stderr).splitlines()) < 8


@pytest.mark.parametrize(
    ("name", "value", "code", "words"),
    [
        ("PYTHONWARNINGS", "default,error::UserWarning", 0, "unset here"),
        ("PYTHONPATH", "{folder}", 1, "ImportError: another numpy"),
        ("PYTHONPATH", "{folder}/empty", 0, ""),
        ("PYTHONHOME", "{folder}", 0, ""),
    ],
)
def test_variables_of_python_that_stop_all_programs_are_named(tmp_path, name, value, code, words):
    """env.sh unsets the variable, or ends with its name and the reason."""
    (tmp_path / "numpy").mkdir()
    (tmp_path / "numpy" / "__init__.py").write_text("raise ImportError('another numpy')")
    clean = {key: text for key, text in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        ["bash", "-c", ". ./env.sh && python -c 'import plate_core; print(12)'"],
        cwd=ROOT, env=clean | {name: value.format(folder=tmp_path)}, text=True, capture_output=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (code, "" if code else "12\n")
    assert done.stderr.startswith(f"env.sh: {name} is '") if words else not done.stderr
    assert words in done.stderr


def test_a_middleware_that_the_wheels_do_not_contain_is_named():
    """A ROS that was installed before can contain any middleware."""
    wheels = (ROOT / ".venv/lib/librmw_fastrtps_cpp.so").exists()
    for name, code in (("rmw_cyclonedds_cpp", int(wheels)), ("rmw_fastrtps_cpp", 0)):
        done = subprocess.run(
            ["bash", "-c", ". ./env.sh"], cwd=ROOT, text=True, capture_output=True,
            env=os.environ | {"RMW_IMPLEMENTATION": name},
        )  # fmt: skip
        assert done.returncode == code
        assert done.stderr.startswith(f"env.sh: RMW_IMPLEMENTATION is '{name}'") is bool(code)


@pytest.mark.parametrize("name", ["setup.sh", "cli.sh"])
def test_a_folder_for_temporary_files_that_is_missing_or_has_a_space_is_not_used(tmp_path, name):
    script = (ROOT / "tools" / name).read_text()
    (line,) = re.findall(r'^case "\$\{TMPDIR.*', script, re.MULTILINE)
    for folder in map(tmp_path.joinpath, ("temporary", "my files", "für", "missing")):
        if folder.name != "missing":
            folder.mkdir()
        done = subprocess.run(
            ["bash", "-c", f'{line}; rmdir "$scratch"; printf %s "$scratch"'],
            env=os.environ | {"TMPDIR": str(folder)}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        usable = folder.name == "temporary" and str(tmp_path).isascii() and " " not in str(tmp_path)
        assert Path(done.stdout).parent == (folder if usable else Path("/tmp"))
