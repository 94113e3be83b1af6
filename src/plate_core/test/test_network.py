"""By default DDS keeps to this machine."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from plate_core import PlateError, choose_network, memory_problem, node_namespace, ros_domain

ENV_SH = "/elsewhere/config/fastdds.xml"
"""Variables that env.sh exports, whatever is requested later."""


@pytest.mark.parametrize(
    ("given", "profile", "warning"),
    [
        ({}, "fastdds.xml", ""),
        ({"ROS_STATIC_PEERS": ""}, "fastdds.xml", ""),
        ({"ROS_STATIC_PEERS": "10.0.0.2;::1"}, "fastdds_network.xml", "ROS_STATIC_PEERS is 10."),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
            "fastdds_network.xml", "ROS_AUTOMATIC_DISCOVERY_RANGE is SUBNET",
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("before", [{}, {"FASTRTPS_DEFAULT_PROFILES_FILE": ENV_SH}])
def test_only_a_request_opens_the_network(given, profile, warning, before):
    environ = given | before
    assert choose_network(environ).startswith(warning)
    assert bool(choose_network(environ)) == bool(warning)
    assert Path(environ["FASTRTPS_DEFAULT_PROFILES_FILE"]).name == profile
    assert environ["FASTRTPS_DEFAULT_PROFILES_FILE"] != ENV_SH
    assert environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == given.get(
        "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"
    )


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "is 'OFF', allowed: LOCALHOST, SUBNET"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "subnet", "is 'subnet', allowed: LOCALHOST, SUBNET"),
        ("ROS_STATIC_PEERS", "10.0.0.2;300.1.1.1", "contains '300.1.1.1', allowed: addresses"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/no/dds.xml", "is '/no/dds.xml', allowed: an existing"),
    ],
)
def test_values_with_which_programs_would_not_find_each_other_are_refused(name, value, words):
    with pytest.raises(PlateError, match=f"^{name} {words}"):
        choose_network({name: value})


@pytest.mark.parametrize("problem", ["Network is unreachable", "timed out"])
def test_a_loopback_interface_that_does_not_work_is_named(monkeypatch, problem):
    def send(*_):
        if problem != "timed out":
            raise OSError(problem)

    monkeypatch.setattr("socket.socket.sendto", send)
    monkeypatch.setattr("plate_core.network.LOOPBACK_S", 0.01)
    with pytest.raises(PlateError, match=rf"lo \(127.0.0.1\) does not work \({problem}\), allowed"):
        choose_network({})
    choose_network({"ROS_STATIC_PEERS": "10.0.0.2"})  # other interfaces suffice


def test_missing_shared_memory_is_reported(tmp_path):
    """As in a container without /dev/shm: images then go over UDP, and a task takes minutes."""
    assert memory_problem(tmp_path) == ""
    missing = tmp_path / "shm"
    assert memory_problem(missing).startswith(f"{missing} cannot be written, allowed: a folder")


def test_full_shared_memory_is_reported(tmp_path, monkeypatch):
    """A program that writes into it ends without a message."""
    for free, problem in ((2**20, ""), (2**20 - 1, f"{tmp_path} is full, allowed: at least 1 MB")):
        status = SimpleNamespace(f_bavail=free, f_frsize=1)
        monkeypatch.setattr("os.statvfs", lambda _, status=status: status)
        assert memory_problem(tmp_path).startswith(problem)
        assert bool(memory_problem(tmp_path)) == bool(problem)


FOREIGN = """<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
<participant profile_name="other" is_default_profile="true"/></profiles>"""

ADDRESSES = """
import os, rclpy, socket
from plate_core import PlateError, choose_network, ros_domain
choose_network(os.environ)
rclpy.init()
node = rclpy.create_node("lone")
for number in map(int, os.listdir("/proc/self/fd")):
    try:
        own = socket.socket(fileno=os.dup(number))
    except OSError:  # no socket
        continue
    if (own.family, own.type) == (socket.AF_INET, socket.SOCK_DGRAM):
        print(own.getsockname()[0])
"""


def addresses(folder: Path) -> list[str]:
    """Local addresses of the sockets that a node has which is started in a folder."""
    command = [sys.executable, "-c", ADDRESSES]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=60, check=True
    )
    return sorted(done.stdout.split())


def test_a_network_profile_in_the_current_folder_is_ignored(tmp_path):
    pytest.importorskip("rclpy")
    alone = addresses(tmp_path)
    assert "127.0.0.1" in alone
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(FOREIGN)
    assert addresses(tmp_path) == alone


def test_a_network_profile_of_the_user_is_kept(tmp_path):
    profile = tmp_path / "dds.xml"
    profile.touch()
    environ = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}
    choose_network(environ)
    assert environ["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(profile)


@pytest.mark.parametrize("text", ["233", "5000", "abc", "-1", "1.0"])
def test_a_domain_without_ports_is_refused(text):
    with pytest.raises(PlateError, match=f"ROS_DOMAIN_ID is '{text}', allowed: a whole number"):
        ros_domain({"ROS_DOMAIN_ID": text})
    assert (ros_domain({}), ros_domain({"ROS_DOMAIN_ID": "232"})) == (0, 232)


def test_a_namespace_is_read_as_in_launch_files():
    for text, namespace in (("", "/"), ("/", "/"), ("left", "/left"), ("/left/", "/left"),
                            ("cell/left_2/", "/cell/left_2")):  # fmt: skip
        assert node_namespace(text) == namespace
    for text in ("a b", "9left", "a//b", "~", "//", "left\n", "\u00e9"):
        with pytest.raises(PlateError, match=r"^namespace is .*, allowed: words of letters"):
            node_namespace(text)
