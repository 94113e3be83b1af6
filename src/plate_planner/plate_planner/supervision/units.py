"""Check of the unit of positions that another program publishes as the topic parts."""

from __future__ import annotations

import numpy as np

from plate_core import Parts, PlateError, Rig

FAR = 5.0
"""Minimum distance of a part from the plate's centre for which the unit counts as wrong [half side
lengths of the plate]. The detector does not detect parts that far outside the plate."""

UNITS = {"cm": 100.0, "mm": 1000.0}
"""Units that other programs use, and their number in a metre."""


def check_positions(parts: Parts, rig: Rig) -> None:
    """Refuse parts that are far outside the plate.

    Raises
    ------
    PlateError
        If a part is far outside the plate. If all parts would be on the plate with positions in
        another unit, the message names this unit.
    """
    ratio = np.max(np.abs(parts.position) / rig.plate.half, axis=1, initial=0.0)
    if not np.any(ratio > FAR):
        return
    worst = int(np.argmax(ratio))
    (x, y), (half_x, half_y) = parts.position[worst], rig.plate.half
    unit = next((name for name, count in UNITS.items() if ratio[worst] <= count), "")
    hint = ""
    if unit:
        hint = f"; in {unit}, this position would be on the plate: publish positions in m"
    raise PlateError(
        f"parts: position of {parts.ids[worst]} is ({x:g}, {y:g}) m, far outside the plate, "
        f"allowed: -{half_x:g} to {half_x:g} m in x, -{half_y:g} to {half_y:g} m in y{hint}"
    )
