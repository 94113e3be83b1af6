"""Driver: sends plate cycles to the motors within the rig's limits. After a stop, the motors stay
off until a person enables them again.

Other packages use the driver's modules `setpoints`, `transports`, `calibration` and `freshness`.
"""

__all__: list[str] = []
