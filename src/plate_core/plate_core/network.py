"""Network access to the nodes of a process. By default, only programs on this machine can reach the
nodes.

`choose_network` sets the environment variables that select a profile of Fast DDS and the discovery
range. `memory_problem` checks the shared memory of Fast DDS. `ros_domain` reads the ROS domain from
the environment, and `node_namespace` reads a namespace.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from .errors import PlateError
from .yaml_fields import config_path

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
SKIP_OTHERS = "SKIP_DEFAULT_XML_FILE"
"""Name of an environment variable. If its value is 1, Fast DDS does not read
DEFAULT_FASTRTPS_PROFILES.xml from the current folder."""

OWN, NETWORK = "fastdds.xml", "fastdds_network.xml"
"""Profiles in config/. `OWN` restricts DDS to this machine, `NETWORK` allows the network."""

MEMORY = "/dev/shm"
"""Folder of shared memory, through which programs on the same machine exchange images."""

MEMORY_BYTES = 2**20
"""Minimum free size of this folder [bytes]."""

LAST_DOMAIN = 232
"""Highest ROS domain. Higher domain numbers would give invalid UDP ports."""

RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"

RANGES = ("LOCALHOST", "SUBNET", "SYSTEM_DEFAULT")
"""Allowed discovery ranges. With the range OFF, programs would not find each other."""

LOOPBACK_S = 1.0
"""Maximum time of a datagram from this machine to itself [s]."""


def choose_network(environ: MutableMapping[str, str]) -> str:
    """Restrict DDS to this machine, unless environment variables name other machines (peers) or a
    wider range.

    Call this function before the process creates its first node. If the environment names a Fast
    DDS profile that does not belong to this project, this profile remains in use. A profile in the
    current folder is not read.

    Parameters
    ----------
    environ : mapping
        Usually `os.environ`. It is modified.

    Returns
    -------
    str
        Warning that states why the nodes are reachable over the network. Empty if they are not
        reachable.

    Raises
    ------
    PlateError
        If the discovery range or a peer is not valid, if the Fast DDS profile does not exist, or if
        the loopback interface is needed and does not work. Without this check, programs would not
        find each other.
    """
    reach, peers = environ.setdefault(RANGE, "LOCALHOST") or "SUBNET", environ.get(PEERS, "")
    if reach not in RANGES:
        raise PlateError(f"{RANGE} is {reach!r}, allowed: {', '.join(RANGES)}")
    for peer in filter(None, peers.split(";")):
        _check_peer(peer)
    is_open = bool(peers) or reach != "LOCALHOST"
    environ[SKIP_OTHERS] = "1"
    if Path(environ.get(PROFILE, "")).name in ("", OWN, NETWORK):
        environ[PROFILE] = str(config_path(NETWORK if is_open else OWN))
        if not is_open:
            check_loopback()
    elif not Path(environ[PROFILE]).is_file():
        raise PlateError(f"{PROFILE} is {environ[PROFILE]!r}, allowed: an existing file, or unset")
    if not is_open:
        return ""
    why = f"{PEERS} is {peers}" if peers else f"{RANGE} is {reach}"
    return f"{why}: anyone who can reach this machine over the network can move the plate"


def _check_peer(peer: str) -> None:
    """Raise a PlateError if a peer is no address and no name that this machine can resolve."""
    try:
        socket.getaddrinfo(peer, None)
    except (OSError, UnicodeError) as error:
        raise PlateError(
            f"{PEERS} contains {peer!r}, allowed: addresses or names of machines, "
            f"with ; between them ({error})"
        ) from None


def check_loopback() -> None:
    """Send a datagram through the loopback interface, by which the nodes find each other.

    Raises
    ------
    PlateError
        If the datagram does not arrive.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.settimeout(LOOPBACK_S)
        try:
            own.bind(("127.0.0.1", 0))
            own.sendto(b"\0", own.getsockname())
            own.recv(1)
        except OSError as error:
            raise PlateError(
                f"network interface lo (127.0.0.1) does not work ({error}), allowed: an interface "
                "that is up, because the nodes find each other through it (ip link set lo up)"
            ) from None


def memory_problem(folder: str | Path = MEMORY) -> str:
    """Return a warning if this process cannot create shared memory in the folder, otherwise an
    empty text. Without shared memory, Fast DDS sends images over UDP, which loses many of them. If
    the folder is full, the system ends the process."""
    if "fastrtps" not in os.environ.get("RMW_IMPLEMENTATION", "fastrtps"):
        return ""
    if os.access(folder, os.W_OK | os.X_OK):
        status = os.statvfs(folder)
        if status.f_bavail * status.f_frsize >= MEMORY_BYTES:
            return ""
        return (
            f"{folder} is full, allowed: at least {MEMORY_BYTES // 2**20} MB free. ROS programs "
            "lose images or end with 'Bus error'; remove files of ended programs from the folder"
        )
    return (
        f"{folder} cannot be written, allowed: a folder in memory that this user can write "
        f"(mount -t tmpfs none {folder}). Without it, images are sent over UDP, and many are lost"
    )


def node_namespace(text: str) -> str:
    """Return the namespace of a node in the form that ROS accepts: with a slash at the beginning,
    and without a slash at the end.

    Raises
    ------
    PlateError
        If the text is not a namespace.
    """
    if not re.fullmatch(r"/?|/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*/?", text, re.ASCII):
        raise PlateError(
            f"namespace is {text!r}, allowed: words of letters, digits and _, with / between them"
        )
    return f"/{text.strip('/')}"


def ros_domain(environ: Mapping[str, str]) -> int:
    """Return the ROS domain of a process with this environment.

    Raises
    ------
    PlateError
        If ROS_DOMAIN_ID is not a whole number from 0 to `LAST_DOMAIN`.
    """
    text = environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        raise PlateError(
            f"ROS_DOMAIN_ID is {text!r}, allowed: a whole number from 0 to {LAST_DOMAIN}"
        )
    return int(text)
