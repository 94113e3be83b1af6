"""Who can hear and command the nodes of a process: this machine alone, unless it is asked for."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from pathlib import Path

from .errors import PlateError
from .yaml_fields import config_path

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
SKIP_OTHERS = "SKIP_DEFAULT_XML_FILE"
"""Has Fast DDS not look for a DEFAULT_FASTRTPS_PROFILES.xml in the current folder."""

OWN, NETWORK = "fastdds.xml", "fastdds_network.xml"
"""Profiles of config/: for this machine alone, and for the network."""

LAST_DOMAIN = 232
"""ROS domains with a higher number have no ports."""

RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"


def choose_network(environ: MutableMapping[str, str]) -> str:
    """Have DDS keep to this machine, unless peers are named or a wider range is asked for.

    To be called before a process makes its first node. A profile that is not ours stays if it is
    named; one that only lies in the current folder is not read.

    Parameters
    ----------
    environ : mapping
        `os.environ`; it is changed.

    Returns
    -------
    str
        What is open to whom; "" if nothing is.
    """
    reach, peers = environ.setdefault(RANGE, "LOCALHOST") or "SUBNET", environ.get(PEERS, "")
    is_open = bool(peers) or reach not in ("LOCALHOST", "OFF")
    environ[SKIP_OTHERS] = "1"
    if Path(environ.get(PROFILE, "")).name in ("", OWN, NETWORK):
        environ[PROFILE] = str(config_path(NETWORK if is_open else OWN))
    if not is_open:
        return ""
    why = f"{PEERS} is {peers}" if peers else f"{RANGE} is {reach}"
    return f"{why}: anybody who reaches this machine over the network can move the plate"


def ros_domain(environ: Mapping[str, str]) -> int:
    """Return the ROS domain of a process with this environment.

    Raises
    ------
    PlateError
        If the environment names none.
    """
    text = environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        raise PlateError(
            f"ROS_DOMAIN_ID is {text!r}, allowed: a whole number from 0 to {LAST_DOMAIN}"
        )
    return int(text)
