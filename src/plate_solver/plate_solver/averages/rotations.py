"""Sequences of rotations on the averaged map: searches in C++ from end to end (rotations.hpp)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..fit import Fit
from ..rotations.family import Line, RotationFamily, Sequences
from .request import Request


class SequenceForces(NamedTuple):
    """What is asked of sequences of rotations on the averaged map.

    Attributes
    ----------
    family : Sequences
    position, velocity : (M, 2)
    asked : (3 M,) bool
        Which of force x, force y and curl of each part.
    wanted, scale : (R,)
        These, and what makes force errors of errors in them.
    """

    family: Sequences
    position: np.ndarray
    velocity: np.ndarray
    asked: np.ndarray
    wanted: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, request: Request, family: RotationFamily) -> SequenceForces:
        """Take what is asked from a request."""
        rows = request.rows
        return cls(
            family.plain, request.position, request.velocity, rows,
            request.wanted[rows], request.scale[rows],
        )  # fmt: skip


def fit_mean_force(
    request: Request,
    family: RotationFamily,
    parameters: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Correct a sequence until its average forces (5) are as asked; errors in mu m g."""
    forces = SequenceForces.of(request, family)
    return Fit(*_kernels.fit_mean_force(forces, parameters, tolerance, iterations))


def mean_force_error(
    request: Request, family: RotationFamily, parameters: np.ndarray
) -> np.ndarray:
    """Return what is missed in the rows `request.rows` [mu m g], curls by `CURL_LENGTH_M`."""
    _, twist, dt = family.samples(parameters)
    return _kernels.mean_force_error(SequenceForces.of(request, family), twist, dt)


def force_slopes(
    theta: np.ndarray,
    family: Sequences,
    line: Line,
    position: np.ndarray,
    velocity: np.ndarray,
    asked: np.ndarray,
) -> np.ndarray:
    """Return the derivatives (R, P) of `step_forces`, of the R rows `asked` (3 M,) bool only."""
    return _kernels.force_slopes(theta, family, *line, position, velocity, asked)
