"""All places and angles of a part in a group, compared with separate trials of each."""

import numpy as np
import pytest

from plate_vision._kernels import MAX_OUTSIDE, search, support


def blob(rng, size):
    """Two discs that overlap, as a signed distance (h, w) [px]."""
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
    centre, radius = rng.uniform(0.25, 0.75, (2, 2)) * size[::-1], rng.uniform(6, 12, 2)
    away = [r - np.hypot(x - c[0], y - c[1]) for c, r in zip(centre, radius, strict=True)]
    return np.max(away, axis=0).astype(np.float32)


def outline(points):
    """Points (n, 2) as a template has them: beside their normals."""
    return np.hstack([points, points])[:, :2]


@pytest.mark.parametrize("stride", [1, 3])
@pytest.mark.parametrize("seed", range(3))
def test_a_search_finds_what_trying_each_place_and_turn_does(seed, stride):
    rng = np.random.default_rng(seed)
    free = blob(rng, (34, 41))
    border = np.minimum(free, rng.uniform(1, 9))
    scale, tilt = 500.0, 0.05  # [px/m]; the camera is turned a little
    c, s = scale * np.cos(tilt), scale * np.sin(tilt)
    to_px = np.array([[c, s, 20.3], [s, -c, 17.1]])
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = outline(np.column_stack([0.012 * np.cos(around), 0.007 * np.sin(around)]))
    inner = rng.uniform(-0.6, 0.6, (20, 2)) * [0.012, 0.007]
    pole, turns = np.array([0.001, -0.0005]), np.linspace(0, np.pi, 7, endpoint=False)
    found = search(free, border, to_px, rim, inner, pole, 2.5, turns, stride)

    expected = []
    back = np.linalg.inv(to_px[:, :2])
    for j in range(0, free.shape[0], stride):
        for i in range(0, free.shape[1], stride):
            if free[j, i] < 2.5:
                continue
            at, best = back @ (np.array([i, j]) - to_px[:, 2]), (0.0,)
            for turn in turns:
                c, s = np.cos(turn), np.sin(turn)
                pose = np.append(at - np.array([[c, -s], [s, c]]) @ pole, turn)
                seen, outside = support(free, border, to_px, rim, inner, pose)
                if outside <= 2 * MAX_OUTSIDE and seen > best[0]:
                    best = (seen, *pose)
            if best[0] > 0:
                expected.append((*best[1:], best[0]))
    assert len(expected) > 10
    assert found == pytest.approx(np.array(expected), abs=1e-9)


def test_a_part_beside_the_window_is_outside():
    free = np.full((20, 20), 5.0, np.float32)
    to_px = np.array([[1000.0, 0, 10], [0, -1000, 10]])
    inner = np.array([[0.003, 0.0], [-0.003, 0.0], [0.0, 0.003], [0.0, -0.003]])
    rim = outline(inner)
    assert support(free, free, to_px, rim, inner, np.zeros(3)) == [0, 0]
    assert support(free, free, to_px, rim, inner, np.array([0.009, 0, 0])) == [-0.25, 0.25]
    assert support(free, free, to_px, rim, inner, np.array([0.1, 0, 0])) == [-1, 1]
    assert len(search(free, free, to_px, rim, inner, np.zeros(2), 9.0, np.zeros(1), 1)) == 0
