"""Cycles of a few harmonics, and the truth of a part on one that shakes along x."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from plate_core import PlateCycle

MU, G = 0.25, 9.81
TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15}


def waves(period, sine, cosine, count=256):
    """Cycle with velocity sum_j sine[j] sin((j+1) w t) + cosine[j] cos(...); both (N, 3)."""
    sine, cosine = np.array(sine), np.array(cosine)
    w = 2 * np.pi / period * np.arange(1, len(sine) + 1)
    angle = np.outer(np.arange(count) * period / count, w)
    s, c = np.sin(angle), np.cos(angle)
    return PlateCycle.from_samples(
        period,
        (-c / w) @ sine + (s / w) @ cosine,
        s @ sine + c @ cosine,
        (c * w) @ sine - (s * w) @ cosine,
    )


class TwoHarmonics:
    """Velocity V (sin wt + 0.5 cos 2wt) along x with a peak acceleration of gamma mu g.

    Static friction is `static` times mu g, and a tilt pulls a part along x by `share` of mu g.
    """

    def __init__(self, gamma, static=1.0, fraction=0.0, frequency=30.0):
        self.w, self.period = 2 * np.pi * frequency, 1 / frequency
        sine = (1 - np.sqrt(33)) / 8  # where sin + 2 cos 2 = 0: the peak of cos - sin 2
        peak = np.sqrt(1 - sine**2) * (1 - 2 * sine)
        self.limit = MU * G
        self.top = gamma * self.limit / self.w / peak
        self.hold, self.pull = static * self.limit, fraction * self.limit

    def cycle(self, turn=0.0):
        """The cycle, with an angular velocity in the first harmonic."""
        v = self.top
        return waves(self.period, [[v, 0, turn], [0, 0, 0]], [[0, 0, 0], [0.5 * v, 0, 0]])

    def velocity(self, t):
        return self.top * (np.sin(self.w * t) + 0.5 * np.cos(2 * self.w * t))

    def need(self, t):
        """Acceleration that friction must give to hold the part."""
        return self.top * self.w * (np.cos(self.w * t) - np.sin(2 * self.w * t)) - self.pull

    def travel(self, end):
        """Travel of a part from rest, phase by phase (scipy's DOP853 with events, and brentq), and
        how often it stuck."""
        t = 0.0
        x = 0.0
        v = 0.0
        stuck = 0
        while t < end:
            slip = self.velocity(t) - v
            sign = np.sign(slip)
            if abs(slip) < 1e-11:
                if abs(self.need(t)) <= self.hold:
                    grid = t + np.linspace(0, self.period, 4001)
                    free = np.flatnonzero(np.abs(self.need(grid)) > self.hold)
                    until, stuck = end, stuck + 1
                    if len(free):
                        until = brentq(
                            lambda s: abs(self.need(s)) - self.hold,
                            *grid[free[0] - 1 : free[0] + 1], xtol=1e-16,
                        )  # fmt: skip
                    until = min(end, until)
                    ride = solve_ivp(lambda s, y: [self.velocity(s)], (t, until), [x], **TIGHT)
                    t, x, v = until, ride.y[0, -1], self.velocity(until)
                    if t >= end:
                        break
                sign = np.sign(self.need(t))

            def meets(s, y):
                return self.velocity(s) - y[1]

            meets.terminal, meets.direction = True, -sign
            rate = sign * self.limit + self.pull
            run = solve_ivp(
                lambda s, y, f=rate: [y[1], f], (t, end), [x, v], events=meets, max_step=3e-4,
                **TIGHT,
            )  # fmt: skip
            t, x, v = run.t[-1], *run.y[:, -1]
        return x, stuck
