"""Fits a sequence of rotations to requested mean forces, on the averaged map.

One call runs the whole Levenberg-Marquardt search in C++ (rotations.hpp). The inputs are a
`Request` and the initial parameters of a `RotationFamily`. The output is a `Fit`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..fit import Fit
from ..rotations.family import RotationFamily, Sequences
from .request import Request


class SequenceForces(NamedTuple):
    """Requested forces of a sequence of rotations, in the form that the C++ kernels use.

    Attributes
    ----------
    family : Sequences
    position, velocity : (M, 2)
        Positions [m] and velocities [m/s] of the parts, in plate_home.
    rows : (3 M,) bool
        Mask that states which components are requested: force x, force y and curl of part 1, then
        of part 2, and so on.
    requested : (R,)
        Requested values of the R components for which `rows` is True.
    scale : (R,)
        Factors that convert the errors of these R components to force errors [mu m g].
    """

    family: Sequences
    position: np.ndarray
    velocity: np.ndarray
    rows: np.ndarray
    requested: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, request: Request, family: RotationFamily) -> SequenceForces:
        """Convert a request and a family of sequences to this form."""
        rows = request.rows
        return cls(
            family.kernel_data, request.position, request.velocity, rows,
            request.requested[rows], request.scale[rows],
        )  # fmt: skip


def fit_mean_force(
    request: Request,
    family: RotationFamily,
    parameters: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Adjust a sequence of rotations until its average forces (5) match the request. `tolerance`
    and `Fit.error` have the unit mu m g."""
    forces = SequenceForces.of(request, family)
    return Fit(*_kernels.fit_mean_force(forces, parameters, tolerance, iterations))


def mean_force_error(
    request: Request, family: RotationFamily, parameters: np.ndarray
) -> np.ndarray:
    """Return the errors of the requested components (`Request.rows`) [mu m g]. Errors of curls are
    multiplied by `CURL_LENGTH_M`."""
    _, twist, dt = family.samples(parameters)
    return _kernels.mean_force_error(SequenceForces.of(request, family), twist, dt)
