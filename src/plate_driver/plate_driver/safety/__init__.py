"""Node that stops the motors. It has its own DDS participant and threads, separate from the node
that processes cycles. The driver creates it; other nodes use its services and `driver_status`.
"""

__all__: list[str] = []
