"""The QoS profiles of all topics and services, and the reason for each. Publishers and subscribers
of a topic use the same profile, so that they are compatible."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

IMAGE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=4,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""For images that this project publishes. Subscribers with any reliability can connect. Only the
newest images are needed."""

CAMERA = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=4,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""For subscriptions to images. They can connect to reliable and to best-effort camera drivers."""

DATA = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=5,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""For parts, forces, cycles and setpoints. All messages must arrive. Old messages are not
needed."""

NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""For messages that take long to process. A slow receiver skips all messages except the newest
one."""

LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""For states that a late subscriber must still receive."""

CALLS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""For services and their clients. With the default depth of 10 of ROS, 90 of 100 simultaneous stop
requests get no reply. Clients need this depth too, because the replies to all clients pass through
the queue of each client."""

TRANSFORMS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""For /tf, equal to the profile of tf2_ros. /tf_static uses `LATCHED`."""

RESULT_S = 60
"""Time for which an action server keeps a result for late requests [s]. A result needs 4 kB. The
default of ROS is 900 s."""
