"""Set-up, as far as it goes without an installation."""

import fcntl
import os
import subprocess
from pathlib import Path

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
