"""What the network is to say of a scene is enough to take its parts apart."""

import numpy as np
import pytest
from segmenter.instances import find_instances
from segmenter.scenes import draw_scene
from segmenter.targets import STEP, make_targets

LEAST_PX = 12
"""Of a part, in maps: of less its number may be lost."""


@pytest.fixture(scope="module")
def scenes():
    rng = np.random.default_rng(5)
    return [draw_scene(rng) for _ in range(12)]


def test_true_maps_give_the_parts_back(scenes):
    parts = again = named = 0
    for _, instances in scenes:
        found = find_instances(make_targets(instances))
        true = instances[::STEP, ::STEP]
        named += found.max()
        for number in np.unique(true[true > 0]):
            here = true == number
            if np.count_nonzero(here) >= LEAST_PX:
                there = found == np.bincount(found[here]).argmax()
                parts += 1
                again += np.count_nonzero(here & there) > 0.6 * np.count_nonzero(here | there)
    assert parts > 60
    assert again == parts
    assert named < 1.1 * parts


def test_a_seed_draws_the_same_scene(scenes):
    image, instances = draw_scene(np.random.default_rng(5))
    assert (image == scenes[0][0]).all()
    assert (instances == scenes[0][1]).all()
    assert image.dtype == np.uint8
    assert image.shape[:2] == instances.shape
