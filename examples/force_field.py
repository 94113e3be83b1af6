"""Solve for one plate motion and draw its average force field (the paper's Figures 9 and 10).

python examples/force_field.py [picture.png]
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from plate_core import load_rig
from plate_solver import SinusoidSolver, average_force

parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
parser.add_argument(
    "picture", nargs="?", default="force_field.png", help="default: force_field.png"
)
picture = parser.parse_args().picture
rig = load_rig()

# Two parts receive mean forces in different directions. The mean force on the third part is zero.
position = np.array([[-0.15, 0.05], [0.15, 0.05], [0.0, -0.08]])  # positions of the parts [m]
force = np.array([[0.15, 0.0], [0.0, 0.15], [0.0, 0.0]])  # requested mean forces [mu m g]

solution = SinusoidSolver(rig, harmonics=3).solve(position, force)
print(f"success {solution.success}: {solution.message}")
print(f"period {solution.cycle.period:.3f} s, condition {solution.condition:.1f}")

# Mean force of this motion on parts at a grid of points on the plate.
half = rig.plate.half
x, y = np.meshgrid(np.linspace(-half[0], half[0], 31), np.linspace(-half[1], half[1], 16))
field = average_force(solution.cycle, np.column_stack([x.ravel(), y.ravel()]))

plt.figure(figsize=(10, 5.5))
arrows = plt.quiver(x, y, field[:, 0], field[:, 1], color="0.6", scale=6)
requested = plt.quiver(*position.T, *force.T, color="crimson", scale=1.5, zorder=3)
plt.quiverkey(requested, 0.2, 0.94, 0.15, "0.15 mu mg", labelpos="E", coordinates="figure")
plt.quiverkey(arrows, 0.6, 0.94, 0.3, "0.3 mu mg", labelpos="E", coordinates="figure")
plt.plot(*position.T, "o", color="black", markersize=12)
plt.gca().set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
plt.title("Average force on parts at rest: requested (red), at all other points (grey)")
plt.savefig(picture, dpi=100)
print(f"drawn: {picture}")
