"""Solve for one plate motion and draw its average force field (the paper's Figures 9 and 10).

python examples/force_field.py [picture.png]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from plate_core import load_rig
from plate_solver import SinusoidSolver, average_force

rig = load_rig()

# Two parts, to be pushed in different directions; a third one is to stay where it is.
position = np.array([[-0.15, 0.05], [0.15, 0.05], [0.0, -0.08]])  # [m]
force = np.array([[0.15, 0.0], [0.0, 0.15], [0.0, 0.0]])  # [mu m g]

solution = SinusoidSolver(rig, harmonics=3).solve(position, force)
print(f"success {solution.success}: {solution.message}")
print(f"period {solution.cycle.period:.3f} s, condition {solution.condition:.1f}")

# What the motion does elsewhere on the plate.
half = rig.plate.half
x, y = np.meshgrid(np.linspace(-half[0], half[0], 31), np.linspace(-half[1], half[1], 16))
field = average_force(solution.cycle, np.column_stack([x.ravel(), y.ravel()]))

plt.figure(figsize=(10, 5.5))
plt.quiver(x, y, field[:, 0], field[:, 1], color="0.6", scale=6)
plt.quiver(*position.T, *force.T, color="crimson", scale=1.5, zorder=3)
plt.plot(*position.T, "o", color="black", markersize=12)
plt.gca().set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
plt.title("Average force under parts at rest: asked (red), everywhere (grey)")
picture = sys.argv[1] if len(sys.argv) > 1 else "force_field.png"
plt.savefig(picture, dpi=100)
print(f"drawn: {picture}")
