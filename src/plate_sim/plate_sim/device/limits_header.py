"""A rig's limits as the C header that firmware is built with.

python -m plate_sim.device.limits_header RIG.yaml > limits_rig.h
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from plate_core import PlateError, load_rig

from .limits import DeviceLimits


def header(limits: DeviceLimits, name: str) -> str:
    """Return the header: `LIMITS` with the values of single precision that `limits` stands for.

    Parameters
    ----------
    limits : DeviceLimits
    name : str
        Of the rig file, for those who read the header.
    """
    values = [(field.name, getattr(limits, field.name)) for field in fields(limits)]
    lines = [f"    .{key} = {_literal(np.asarray(value, np.float32))}," for key, value in values]
    return "\n".join([
        f"/* Of {name}, by `python -m plate_sim.device.limits_header`: change that, not this. */",
        "static const Limits LIMITS = {",
        *lines,
        "};",
        "",
    ])  # fmt: skip


def _literal(value: np.ndarray) -> str:
    """Return C for an array or a number; the shortest decimals that give the same float."""
    if value.ndim == 0:
        return f"{value[()]!s}f"
    inner = [_literal(part) for part in value]
    if value.ndim == 1:
        return "{" + ", ".join(inner) + "}"
    return "{\n" + "".join(f"        {part},\n" for part in inner) + "    }"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rig", metavar="RIG.yaml", help="rig file")
    rig = parser.parse_args(arguments).rig
    try:
        limits = DeviceLimits.of_rig(load_rig(rig))
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    sys.stdout.write(header(limits, Path(rig).name))
    return 0


if __name__ == "__main__":
    sys.exit(main())
