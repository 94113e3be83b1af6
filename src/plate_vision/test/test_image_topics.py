"""Advice if no image arrives, for the topics that exist."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from plate_vision.ros import silence_advice

IMAGE, FILE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def advice(topic, **published):
    """Advice for a topic. `published` maps topics without their first slash to types."""
    kinds = {f"/{name.replace('__', '/')}": [kind] for name, kind in published.items()}
    node = SimpleNamespace(
        count_publishers=lambda name: int(name in kinds),
        resolve_topic_name=lambda name: f"/{name}",
        get_topic_names_and_types=lambda: [*kinds.items(), ("/image_raw/zstd", [FILE])],
    )
    return silence_advice(node, topic)


def test_a_topic_with_another_transport_is_named():
    packet = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
    raw, compressed = "/image_raw", "/image_raw/compressed"
    for topic in (raw, compressed):
        text = advice(topic, image_raw__ffmpeg=packet)
        assert "/image_raw/ffmpeg exists: transport is ffmpeg, allowed: raw, compressed" in text
    both = {"image_raw__compressed": FILE, "image_raw__ffmpeg": packet}
    assert advice(raw, **both).endswith("parameter image_transport to compressed")
    assert advice(compressed, image_raw=IMAGE).endswith("parameter image_transport to raw")
    assert "other images" in advice(raw, other__ffmpeg=packet, detections_image=IMAGE)
    assert "(topics with images: /left/image_raw)" in advice(raw, left__image_raw=IMAGE)
    assert advice(raw, image_raw=IMAGE) == "check that the camera runs"
