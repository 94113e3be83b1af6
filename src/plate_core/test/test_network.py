"""By default DDS keeps to this machine."""

from pathlib import Path

import pytest

from plate_core import choose_network

ENV_SH = "/elsewhere/config/fastdds.xml"
"""What env.sh exports, whatever is asked for later."""


@pytest.mark.parametrize(
    ("given", "profile", "told"),
    [
        ({}, "fastdds.xml", ""),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "fastdds.xml", ""),
        ({"ROS_STATIC_PEERS": ""}, "fastdds.xml", ""),
        ({"ROS_STATIC_PEERS": "10.0.0.2"}, "fastdds_network.xml", "ROS_STATIC_PEERS is 10.0.0.2"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
            "fastdds_network.xml", "ROS_AUTOMATIC_DISCOVERY_RANGE is SUBNET",
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("before", [{}, {"FASTRTPS_DEFAULT_PROFILES_FILE": ENV_SH}])
def test_only_what_is_asked_for_opens_the_network(given, profile, told, before):
    environ = given | before
    assert choose_network(environ).startswith(told)
    assert bool(choose_network(environ)) == bool(told)
    assert Path(environ["FASTRTPS_DEFAULT_PROFILES_FILE"]).name == profile
    assert environ["FASTRTPS_DEFAULT_PROFILES_FILE"] != ENV_SH
    assert environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == given.get(
        "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"
    )


def test_a_profile_of_somebody_else_stays():
    environ = {"FASTRTPS_DEFAULT_PROFILES_FILE": "/etc/dds.xml"}
    choose_network(environ)
    assert environ["FASTRTPS_DEFAULT_PROFILES_FILE"] == "/etc/dds.xml"
