"""What stops the motors: a node with a participant and threads of its own, apart from all cycles.

The driver makes it; others use its services and `driver_status`.
"""

__all__: list[str] = []
