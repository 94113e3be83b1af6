"""Programs of nodes: Ctrl-C while their code is loaded, their exit codes, the parent they note."""

import os
import signal
import subprocess
import sys

import pytest
from setuptools import Distribution

from plate_native import node_programs, programs

pytestmark = pytest.mark.filterwarnings("ignore:pkg_resources is:DeprecationWarning")  # setuptools'

MODULE = """
import atexit, os, sys, time
atexit.register(lambda: print("tidied up"))
print("loading", flush=True)
while "load" in sys.argv:
    time.sleep(0.01)

class Lasting:
    def __del__(self):
        print("Python takes itself apart", flush=True)

def main():
    sys.lasting = Lasting()
    assert sys.modules["__main__"].PARENT == os.getppid()
    print("runs")
    if sys.argv[1:]:
        sys.exit(eval(sys.argv[1]))
"""


@pytest.fixture(name="program")
def _program(tmp_path):
    """The program of a node, and of another one, as set-up writes them."""
    (tmp_path / "some").mkdir()
    (tmp_path / "some/__init__.py").write_text(MODULE)
    points = {"console_scripts": ["node = some:main", "other = some:main"]}
    command = node_programs("node")(Distribution({"name": "some", "entry_points": points}))
    command.install_dir, command.outfiles = str(tmp_path), []
    for name in ("node", "other"):
        command.write_script(name, "#!/usr/bin/env python3\nprint('of setuptools')\n")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"}

    def program(*words, **options):
        return subprocess.Popen(
            [tmp_path / words[0], *words[1:]], env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options,
        )  # fmt: skip

    return program


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, -signal.SIGTERM)]
)
@pytest.mark.parametrize("disposition", [signal.SIG_DFL, signal.SIG_IGN])
def test_a_signal_while_code_is_loaded_ends_the_program_without_output(
    program, number, code, disposition
):
    with program("node", "load", preexec_fn=lambda: signal.signal(number, disposition)) as node:
        assert node.stdout.readline() == "loading\n"
        node.send_signal(number)
        assert node.communicate(timeout=60) == ("", "")
    assert node.returncode == code


def test_ctrl_c_before_its_first_line_waits_for_it(program, tmp_path):
    line = (tmp_path / "node").read_text().partition("\n")[0]
    if programs.HOLDING not in line:
        pytest.fail(f"{line}: this machine's env cannot hold signals back")
    shows = tmp_path / "shows"
    shows.write_text(f"{line}\nimport signal\nprint(signal.pthread_sigmask(0, []))\n")
    shows.chmod(0o755)
    assert "SIGINT" in subprocess.run([shows], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(
    ("word", "code", "errors"),
    [(None, 0, ""), ("3", 3, ""), ("None", 0, ""), ("'a reason'", 1, "a reason\n")],
)
def test_a_program_ends_at_once_with_its_exit_code(program, word, code, errors):
    with program("node", *([word] if word else [])) as node:
        output = node.communicate(timeout=60)
    assert (node.returncode, *output) == (code, "loading\nruns\ntidied up\n", errors)


def test_in_a_shell_that_does_not_know_the_packages_it_names_the_remedy(program, tmp_path):
    environment = {"PATH": os.environ["PATH"], "PYTHONSAFEPATH": "1"}
    done = subprocess.run([tmp_path / "node"], env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("error: No module named 'some'; first source env.sh, or ")
    assert done.stderr.count("\n") == 1
    (tmp_path / "some/__init__.py").write_text("import no_such_library")
    with program("node") as node:
        assert "Traceback" in node.communicate(timeout=60)[1]


def test_a_defect_is_shown(program):
    with program("node", "1 / 0") as node:
        _, errors = node.communicate(timeout=60)
    assert node.returncode == 1
    assert errors.endswith("ZeroDivisionError: division by zero\n")


def test_other_programs_are_as_setuptools_writes_them(program):
    with program("other") as other:
        assert other.communicate(timeout=60) == ("of setuptools\n", "")


@pytest.mark.parametrize("env", ["/bin/false", "/no/such/env"])
def test_an_env_without_signal_blocking_is_not_used_for_it(monkeypatch, env):
    monkeypatch.setattr(programs, "ENV", env)
    assert programs.first_line("#!/usr/bin/python3") == "#!/usr/bin/python3"


def test_the_interpreter_stays_the_same():
    begin = f"#!/usr/bin/env -S {programs.HOLDING} "
    assert programs.first_line("#!/usr/bin/env python3") == f"{begin}python3"
    assert programs.first_line(f"#!{sys.executable}") == f"{begin}{sys.executable}"
