"""Type of the record that contains the constants of one part for the compiled kernels
(`step.hpp`)."""

import numpy as np

BODY = np.dtype(
    [
        (name, np.float64)
        for name in ("mu_g", "gyration2", "radius", "reach", "slim", "mass_inverse")
    ]
    + [(name, np.int64) for name in ("first_point", "end_point", "first_piece", "end_piece")]
)
"""Constants of a part.

- mu g [m/s2], set by the kernel
- inertia divided by mass [m2]
- radius of a disc [m], 0 for other shapes
- maximum distance of the outline from the centre of mass [m]
- about half the minimum width [m]
- 1/mass [1/kg]
- first point in the mesh (`patch.hpp`) and last point + 1; no points for a disc
- first convex piece and last piece + 1
"""
