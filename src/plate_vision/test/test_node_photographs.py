"""Photographs: the detector measures each image separately."""

import re

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, Graph, image
from shown_text import says

from plate_core import load_rig
from plate_core.ros import msg_to_parts

pytestmark = pytest.mark.usefixtures("detector_time")


def image_notes(graph):
    """Log lines about photographs, in order."""
    return [text for text in graph.notes if text.startswith("image ")]


def test_photographs_are_taken_each_by_itself(draw, rng):
    labels = [LABEL, LABEL, LABEL[::-1]]
    graph = Graph(photographs=True)
    try:
        found = [
            msg_to_parts(
                graph.answer(image(draw(CENTRE_PX, label, rng, radius=7.9), 1 + k, "mono8"))
            )
            for k, label in enumerate(labels)
        ]
        assert [parts.ids for parts in found] == [("black_1", "grey_1")] * 3
        places = [dict(zip(parts.ids, parts.position, strict=True)) for parts in found]
        assert places[1]["black_1"] == pytest.approx(places[0]["black_1"], abs=1e-3)
        assert places[2]["black_1"] == pytest.approx(places[0]["grey_1"], abs=1e-3)
        assert image_notes(graph) == [f"image {k}: 2 parts: 1 black, 1 grey" for k in (1, 2, 3)]
        assert graph.warnings == []
    finally:
        graph.close()


def test_photographs_wait_for_a_slow_detector(draw, rng):
    """Otherwise the numbers of the detector and of the camera would differ."""
    graph = Graph(photographs=True)
    try:
        picture = draw(CENTRE_PX, LABEL, rng, radius=7.9)
        graph.answer(image(picture, 1.0, "mono8"))
        for k in range(12):
            graph.images.publish(image(picture, 2.0 + k, "mono8"))
        graph.until(lambda: graph.detector._images == 13)
    finally:
        graph.close()


def test_the_outline_of_each_photograph_is_checked(rng):
    """The camera was moved between the photographs."""
    corners = np.array(load_rig().camera.corners_px)
    graph = Graph(photographs=True)
    try:
        for k, shift in enumerate((0.0, 30.0, 0.0)):
            picture = np.full((480, 640), 60, np.uint8)
            cv2.fillPoly(picture, [np.round(corners + [0.0, shift]).astype(int)], 200)
            noisy = np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255)
            graph.images.publish(image(noisy.astype(np.uint8), 1.0 + k))
            graph.until(lambda k=k: graph.detector._images == k + 1)
        (warning,) = [text for text in graph.warnings if "outline" in text]
        assert says(warning, "image 2: the plate's outline differs", "it is shifted by (0.0, -30.")
    finally:
        graph.close()


def test_photographs_of_another_size_show_the_whole_plate():
    """Of a plate 0.6 m long on 480 px a part of 8 mm radius has 6.4 px."""
    picture = np.full((300, 480), 220, np.uint8)
    for x, y in CENTRE_PX - 50:
        cv2.circle(picture, (int(x), int(y)), 6, 40, -1, cv2.LINE_AA)
    graph = Graph(photographs=True)
    try:
        graph.images.publish(image(picture, 1.0))
        graph.until(lambda: graph.parts)
        parts = msg_to_parts(graph.parts[0])
        assert parts.ids == ("black_1", "black_2")
        expected = (CENTRE_PX - 50 - [239.5, 149.5]) * [1, -1] * 0.6 / 480
        assert np.abs(parts.position - expected).max() < 2e-4
        (warning,) = graph.warnings
        assert says(warning, "480 x 300 px", "640 x 480 px", "0.6 x 0.375 m", "0.6 x 0.3 m")
    finally:
        graph.close()


def test_parts_of_another_size_than_in_the_rig(draw, rng):
    place = np.array([[200.0, 200], [300, 220], [400, 240], [450, 300]])
    large = draw(place, ["black"] * 3 + ["grey"], rng, radius=12.0)
    empty = draw(np.zeros((0, 2)), [], rng)
    other = np.full((100, 200), 220, np.uint8)
    graph = Graph(photographs=True)
    try:
        for k, picture in enumerate((large, empty, other)):
            graph.images.publish(image(picture, 1.0 + k))
            graph.until(lambda k=k: graph.detector._images == k + 1)
        assert image_notes(graph) == ["image 1: no parts; 4 unknown", "image 2: no parts"]
        size, refused = graph.warnings
        found = re.match(
            r"image 1: no part .* 4 too large \(radius is ([0-9.]+) mm, .* 8 mm\)",
            size,
        )
        assert found, size
        assert float(found[1]) == pytest.approx(12.0, rel=0.03)
        assert refused.startswith("image 3 ignored: image: size is 200 x 100 px, allowed: 640 x")
    finally:
        graph.close()


def test_a_photograph_that_shows_parts_too_small_is_refused():
    graph = Graph(photographs=True)
    try:
        assert graph.answer(image(np.full((90, 180), 220, np.uint8), 1.0)) is None
        assert says(graph.warnings[0], "radius_m is 0.008", "2.4 px", "allowed: 3 to")
    finally:
        graph.close()
