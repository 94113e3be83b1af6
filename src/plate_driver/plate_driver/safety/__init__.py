"""Node that stops the motors. The node has its own DDS participant and threads, separate from the
node that processes cycles. The driver creates both nodes. Other nodes use the services and the
topic `driver_status` of this node.
"""

__all__: list[str] = []
