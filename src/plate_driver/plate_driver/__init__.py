"""Takes plate cycles to the motors, within the rig's limits and with a stop that latches.

Others use its chapters `setpoints`, `transports`, `calibration` and `freshness`.
"""

__all__: list[str] = []
