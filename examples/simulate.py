"""Simulate parts on a shaking plate and draw how they move.

python examples/simulate.py [picture.png]
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from plate_core import PlateCycle, load_rig
from plate_sim import simulate

parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
parser.add_argument("picture", nargs="?", default="simulate.png", help="default: simulate.png")
picture = parser.parse_args().picture
rig = load_rig()

# The plate motion along x is the sum of two sinusoids. This motion is fast in one direction and
# slow in the other direction. Parts drift, because the friction force does not depend on the
# sliding speed.
period = 0.05
t = np.arange(256) / 256 * period
w = 2 * np.pi / period
pose = np.zeros((len(t), 3))
pose[:, 0] = 0.002 * (np.sin(w * t) + 0.25 * np.sin(2 * w * t))
cycle = PlateCycle.from_samples(period, pose)

# Three parts: the first is at rest, and the others have initial velocities along x and y.
position = np.array([[0.0, -0.05], [0.0, 0.0], [0.0, 0.05]])  # positions of the parts [m]
velocity = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])  # velocities of the parts [m/s]
path = simulate(cycle, position, velocity, rig.friction.mu, cycles=20)

drift = (path.position[-1] - path.position[0]) / path.time[-1]
for start, (vx, vy) in zip(position, drift, strict=True):
    print(f"part at y = {start[1]:+.2f} m: mean drift {1e3 * vx:+.2f}, {1e3 * vy:+.2f} mm/s")

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
left.plot(path.time, 1e3 * path.position[..., 0])
left.set(xlabel="time [s]", ylabel="x [mm]", title="Parts")
right.plot(path.time[path.time <= 2 * period], path.velocity[path.time <= 2 * period, 0, 0])
right.plot(t, cycle.twist(t)[:, 0], color="0.6")
right.set(xlabel="time [s]", ylabel="velocity [m/s]", title="Plate (grey), first part")
figure.tight_layout()
figure.savefig(picture, dpi=100)
print(f"drawn: {picture}")
