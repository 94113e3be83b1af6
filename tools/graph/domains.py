"""ROS domains: a program that starts nodes takes one that nobody else on this machine has."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

DOMAINS = range(1, 102)
"""ROS domains whose ports do not collide with those that Linux hands out itself."""


@contextmanager
def own_domain(chosen: int | None = None) -> Iterator[int]:
    """Take a ROS domain for as long as the context lasts.

    Two that ask at the same time get different ones: a domain is taken by a socket whose name only
    one process at a time can have. Programs that do not ask are seen by the UDP port that the
    first participant of a domain binds (DDSI-RTPS 9.6.1.1: 7410 + 250 domain).

    Parameters
    ----------
    chosen : int, optional
        This one, even if others use it.

    Raises
    ------
    RuntimeError
        If all are taken.
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
