"""Driver: sends plate cycles to the motors within the rig's limits. A stop stays in effect until a
person enables the motors again.

Other packages use its subpackages `setpoints`, `transports`, `calibration` and `freshness`.
"""

__all__: list[str] = []
