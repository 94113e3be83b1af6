"""Set-up, as far as it goes without an installation."""

import fcntl
import os
import subprocess
from pathlib import Path

import needs
import pytest

ROOT = Path(__file__).resolve().parents[1]


def test_a_set_up_that_waits_for_another_one_says_so(tmp_path):
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
        said = process.stdout.readline()
        assert process.poll() is None
    rest, errors = process.communicate(timeout=60)
    assert (said, rest) == ("set-up: waiting for another set-up of this folder to end\n", "")
    assert "ROS 'foxy' is sourced" in errors


def test_it_tells_how_far_a_step_is(tmp_path):
    script = (ROOT / "tools" / "setup.sh").read_text()
    functions = script[script.index("say() {") : script.index("fail() {")]
    (tmp_path / "log").write_text("[1/3] one\n[2/3] two\n-- no count\n")
    words = "set -euo pipefail; busy= telling= counted= log=log; sleep() { command sleep 0.1; }; "
    words += functions + 'step "compiling all"; read -r; end_group "$telling"'
    process = subprocess.Popen(
        ["bash", "-c", words], cwd=tmp_path, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    said = [process.stdout.readline() for _ in range(3)]
    errors = process.communicate("go on\n", timeout=60)[1]
    assert said[0] == "set-up: [0 s] compiling all\n"
    assert all(line.endswith(" s] still compiling [2/3]\n") for line in said[1:])
    assert (process.returncode, errors) == (0, "")


def test_on_another_processor_it_says_at_once_to_install_ros(tmp_path):
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
        assert "180 MB to download" in capsys.readouterr().out


def test_each_module_that_tests_need_is_of_a_pinned_wheel():
    wheels = [pin for file in (needs.WHEELS, needs.BROWSER_WHEELS) for pin in needs.pins(file)]
    names = {pin.partition("==")[0].replace("-", "_").lower() for pin in wheels}
    by_module = {"skimage": "scikit_image", "can": "python_can"}
    assert {by_module.get(module, module) for module in needs.MODULES} <= names
