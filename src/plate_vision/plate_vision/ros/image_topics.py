"""Advice for the user if no image arrives on the detector's topic."""

from __future__ import annotations

from rclpy.node import Node

COMPRESSED = "/compressed"
"""End of the topic of compressed images. The rest is the topic of the raw images."""

KINDS = {"sensor_msgs/msg/Image": "raw", "sensor_msgs/msg/CompressedImage": "compressed"}
"""Types of messages with images, and the values of the parameter `image_transport`."""

OWN = "detections_image"
"""Topic of images that the detector itself publishes."""

SHOWN = 3
"""Maximum number of topics in a message."""


def silence_advice(node: Node, topic: str) -> str:
    """Return what to check if no image arrives on a topic (its full name). If no node publishes
    this topic, the text names existing topics with images."""
    if node.count_publishers(topic):
        return "check that the camera runs"
    own_topic = node.resolve_topic_name(OWN)
    published = {
        name: kinds[0]
        for name, kinds in node.get_topic_names_and_types()
        if name != own_topic and node.count_publishers(name)
    }
    found = {name: KINDS[kind] for name, kind in published.items() if kind in KINDS}
    is_compressed = topic.endswith(COMPRESSED)
    other = topic.removesuffix(COMPRESSED) if is_compressed else topic + COMPRESSED
    if other in found:
        return (
            f"no node publishes this topic, but {other} exists: set the detector's parameter "
            f"image_transport to {found[other]}"
        )
    for name in sorted(published):  # other transports of the same images, such as ffmpeg and theora
        base, _, transport = name.rpartition("/")
        if base == topic.removesuffix(COMPRESSED):
            return (
                f"no node publishes this topic, but {name} exists: transport is {transport}, "
                f"allowed: {', '.join(KINDS.values())}; enable one of them in the camera's driver, "
                "or start republish of the package image_transport"
            )
    wanted = "compressed" if is_compressed else "raw"
    same = sorted(name for name, kind in found.items() if kind == wanted)
    rest = sorted(name for name in found if name not in same)
    if not found:
        return "no node publishes this topic or other images; check that the camera runs"
    name = "image_raw" + COMPRESSED * is_compressed
    listed = ", ".join([*same, *rest][:SHOWN])
    return (
        f"no node publishes this topic; check that the camera runs, or remap {name} and "
        f"camera_info to the camera's topics (topics with images: {listed})"
    )
