"""Dark parts in a picture of a light plate, as centres and areas [px]."""

import numpy as np

BLACK, PLATE = 40.0, 220.0
"""Grey values."""


def light_of(camera):
    """The camera's shading, from an image of a plate that is everywhere."""
    return np.asarray(camera._light, float)


def covered(camera, image, point, reach=25):
    """Centre (2,) [px] and area [px2] of the black pixels around a point [px]."""
    u0, v0 = np.round(point).astype(int)
    window = np.s_[max(v0 - reach, 0) : v0 + reach + 1, max(u0 - reach, 0) : u0 + reach + 1]
    fraction = (PLATE - image[window] / light_of(camera)[window]) / (PLATE - BLACK)
    fraction[np.abs(fraction) < 0.01] = 0  # rounding of grey values
    v, u = np.mgrid[window]
    return np.array([np.sum(fraction * u), np.sum(fraction * v)]) / fraction.sum(), fraction.sum()


def centroid(outline):
    """Centre (2,) and area of a polygon (k, 2)."""
    origin = outline[0]
    a, b = outline - origin, np.roll(outline, -1, axis=0) - origin
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return origin + (a + b).T @ cross / (3 * cross.sum()), abs(cross.sum()) / 2


def ring(radius, count=400):
    turn = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
