"""Node that stops the motors. Its DDS participant and threads are separate from those of the node
that processes cycles. The driver creates both nodes. Other nodes use the services and the topic
`driver_status` of this node.
"""

__all__: list[str] = []
