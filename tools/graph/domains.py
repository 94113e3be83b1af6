"""ROS domains for test runs. Each program that starts nodes reserves a domain that no other program
on this computer uses."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

DOMAINS = range(1, 102)
"""ROS domains whose UDP ports do not collide with Linux's ephemeral ports."""


@contextmanager
def own_domain(chosen: int | None = None) -> Iterator[int]:
    """Reserve a ROS domain until the context ends.

    A domain is reserved by binding a Unix socket whose name only one process can bind. Therefore
    two programs never get the same domain. Other programs are detected by the UDP port that the
    first participant of a domain binds (DDSI-RTPS 9.6.1.1: port = 7410 + 250 domain).

    Parameters
    ----------
    chosen : int, optional
        Domain to use without a check.

    Raises
    ------
    RuntimeError
        If all domains are in use.
    """
    if chosen is not None:
        yield chosen
        return
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        with (
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as taken,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port,
        ):
            try:
                taken.bind(f"\0ros_domain_{domain}")
                port.bind(("", 7410 + 250 * domain))
            except OSError:
                continue
            port.close()
            yield domain
            return
    raise RuntimeError(f"all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use")
