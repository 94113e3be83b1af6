"""Command that prints the C header with the limits of a rig for the firmware.

python -m plate_sim.device.limits_header RIG.yaml > limits_rig.h
"""

import argparse
import sys

from plate_core import PlateError, piped

from .limits import rig_header


@piped()
def main() -> int:
    """Run the command, and return its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
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
