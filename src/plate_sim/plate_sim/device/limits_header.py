"""A rig's limits as the C header that firmware is built with.

python -m plate_sim.device.limits_header RIG.yaml > limits_rig.h
"""

import argparse
import sys
from pathlib import Path

from plate_core import PlateError, load_rig

from .limits import DeviceLimits, c_header


def rig_header(path: str) -> str:
    """Return the header of a rig file.

    Raises
    ------
    PlateError
        If the file is wrong.
    """
    rig = load_rig(path)
    drives = [motor.drive for motor in rig.motors if motor.drive is not None]
    return c_header(DeviceLimits.of_rig(rig), Path(path).name, drives)


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rig", metavar="RIG.yaml", help="rig file")
    path = parser.parse_args().rig
    try:
        header = rig_header(path)
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    sys.stdout.write(header)
    return 0


if __name__ == "__main__":
    sys.exit(main())
