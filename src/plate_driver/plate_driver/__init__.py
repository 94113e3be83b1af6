"""Takes plate cycles to the motors, within the rig's limits and with a stop that latches.

Others use its chapters `setpoints`, `transports` and `calibration`.
"""

__all__: list[str] = []
