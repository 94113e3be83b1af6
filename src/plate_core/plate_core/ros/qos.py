"""The QoS profiles of all topics and services, with reasons. Publishers and subscribers of a topic
use the same profile, so that they are compatible."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

IMAGE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=4,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Profile for images that this project publishes. Subscribers with any reliability can connect.
Only the newest images are needed."""

CAMERA = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=4,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""Profile for subscriptions to images. These subscriptions can connect to reliable and to
best-effort camera drivers."""

PHOTOGRAPHS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""Profile for subscriptions to photographs. All photographs are evaluated and numbered, also if the
receiver is slow."""

DATA = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=5,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Profile for parts, forces, cycles and setpoints. All messages must arrive. A late subscriber does
not need old messages."""

NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Profile for messages that take a receiver a long time to process. A slow receiver processes only
the newest message."""

LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Profile for states that a late subscriber must also receive."""

CALLS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Profile for services and their clients. With ROS's default depth of 10, 90 of 100 simultaneous
stop requests get no reply. Clients need the larger depth too, because each client's queue also
receives the replies to all other clients."""

TRANSFORMS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Profile for the topic /tf, equal to the profile in tf2_ros. The topic /tf_static uses
`LATCHED`."""

RESULT_S = 60
"""Time for which an action server keeps a result for late requests [s]. Each stored result needs 4
kB. The default time of ROS is 900 s."""
