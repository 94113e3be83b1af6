"""What kernels know of parts, which `step.hpp` moves through a step."""

import numpy as np

BODY = np.dtype(
    [
        (name, np.float64)
        for name in ("mu_g", "gyration2", "radius", "reach", "slim", "mass_inverse")
    ]
    + [(name, np.int64) for name in ("first_point", "end_point", "first_piece", "end_piece")]
)
"""What does not change of a part: mu g [m/s2], which the kernel fills in; inertia by mass [m2];
radius of a disc, else 0 [m]; greatest distance of the rim from the centre of mass [m]; about half
the least width [m]; 1/mass [1/kg]; its first point in the mesh (`patch.hpp`), its last + 1, none
for a disc; its first convex piece, its last + 1."""
