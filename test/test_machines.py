"""The graph on two machines: network namespaces joined by a cable."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from short_task import short_task

pytest.importorskip("rclpy")

from plate_core import config_path

MACHINES = Path(__file__).resolve().parents[1] / "tools" / "machines.py"
IMAGE_KB = 307
TINY = short_task(0.02, 60)


def namespaces_work() -> bool:
    """Whether we may make network namespaces."""
    if not all(shutil.which(program) for program in ("ip", "nsenter", "unshare")):
        return False
    made = subprocess.run(["unshare", "--net", "--mount", "true"], capture_output=True, check=False)
    return made.returncode == 0


pytestmark = pytest.mark.skipif(not namespaces_work(), reason="needs root and network namespaces")


def machines(tmp_path, *words):
    file = tmp_path / "result.json"
    done = subprocess.run(
        [sys.executable, str(MACHINES), *words, "--json", str(file)],
        capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(file.read_text(encoding="utf-8"))


def test_the_loop_closes_between_machines_that_name_each_other(tmp_path):
    scenario = tmp_path / "tiny.yaml"
    scenario.write_text(yaml.safe_dump(TINY), encoding="utf-8")
    result = machines(tmp_path, "--reach", "named", "--scenario", str(scenario))
    assert result["done"]
    assert result["images"] > 10
    # Parts, motor tables and the announcements of the participants cross the cable: 1.0 and
    # 1.2 MB/s in two short tasks. The images would add 1.5 to 3 MB/s, with cycles of 0.2 to 0.1 s.
    cycle_s = 0.1
    assert 0 < result["crossed_kB_per_s"] < 0.75 * IMAGE_KB / cycle_s


def test_by_default_no_message_leaves_the_machine(tmp_path):
    result = machines(tmp_path, "--reach", "nobody")
    assert result["found"] == []
    assert result["crossed_kB"] == 0


def test_the_two_network_profiles_differ_only_in_the_interfaces():
    own, network = (
        re.sub(r"<!--.*?-->", "", config_path(name).read_text(encoding="utf-8"), flags=re.DOTALL)
        for name in ("fastdds.xml", "fastdds_network.xml")
    )
    narrowed = re.sub(r"\s*<interfaceWhiteList>.*?</interfaceWhiteList>", "", own, flags=re.DOTALL)
    assert narrowed == network != own
