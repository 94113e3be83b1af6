"""Measure how late this computer sends setpoints as the master of drives: `ros2 run plate_drives
lateness`.

The program needs no bus and moves nothing. Without ROS, use `python -m plate_drives.lateness RIG`.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import sys
import time

import numpy as np

from plate_core import PlateError, load_rig, piped

from .socketcan import ENDED, HostPort, HostTransport, program_of

__all__ = ["main"]

POLL_S = 0.002

FIRST_S = 10.0
"""Maximum time until the process with the firmware sends its first report [s]. On a busy computer,
this process starts late."""


def measured(transport: HostTransport, seconds: float) -> np.ndarray:
    """Return the maximum delay of setpoints in each interval of 10 ms [ms]. The first interval
    begins with the first report of the process with the firmware.

    The measurement ends after `seconds`, or when the user presses Ctrl-C. If the process sends no
    report, the result is a single infinite value.
    """
    late: list[float] = []
    end = time.monotonic() + FIRST_S
    with contextlib.suppress(KeyboardInterrupt):
        while time.monotonic() < end:
            if transport.poll():
                if not late:
                    end = time.monotonic() + seconds
                late.append(transport.load)
                transport.values()  # `values` resets the maximum in `load`
            elif ENDED in transport.report().text:
                break
            time.sleep(POLL_S)
    return np.array(late or [np.inf])


@piped()
def main() -> None:
    """Run the command line. Exit code 0: setpoints are in time, 1: setpoints are too late, 2: wrong
    arguments or files."""
    parser = argparse.ArgumentParser(
        prog="lateness", description="Measure how late this computer sends setpoints as the master "
        "of drives on a CAN bus, and compare the result with the limit of a rig. During the "
        "measurement, put the same load on the computer as in operation.",
    )  # fmt: skip
    parser.add_argument("rig", help="rig file with drives, or its name in config/rigs")
    parser.add_argument("--seconds", type=float, default=20.0, help="duration [s] (default: 20)")
    args = parser.parse_args()
    try:
        rig = load_rig(args.rig)
        program = program_of(rig)
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    # The two sockets simulate a CAN bus without drives.
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with near, far:
        transport = HostTransport(
            lambda: HostPort(program, f"nowhere {os.getpid()}", lambda _: far.dup()),
            rig.limits,
            time.monotonic,
            1,
        )
        transport.open()
        late, why = measured(transport, args.seconds), transport.report().text
        transport.close()
    if np.isinf(late).any():
        print(f"error: {why}", file=sys.stderr)
        sys.exit(2)
    print(
        f"maximum delay of setpoints in each 10 ms: median {np.median(late):.2f} ms, 99th "
        f"percentile {np.percentile(late, 99):.2f} ms, maximum {late.max():.2f} ms; allowed: "
        f"{transport.allowed_ms:.2f} ms"
    )
    sys.exit(int(late.max() > transport.allowed_ms))


if __name__ == "__main__":
    main()
