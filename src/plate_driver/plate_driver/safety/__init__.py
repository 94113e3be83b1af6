"""Node that stops the motors. Its DDS participant and threads are separate from the node that
processes cycles. The driver creates it. Other nodes use its services and `driver_status`.
"""

__all__: list[str] = []
