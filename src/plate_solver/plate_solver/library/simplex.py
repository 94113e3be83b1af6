"""A linear programme that selects a few rotations from a large library and computes their fractions
of the time.

    minimise    cost . abs(w) + miss_cost . abs(A w - b)

The columns of A belong to rotations, and the rows to requested quantities b. w contains the weights
of the rotations. A negative weight reverses the rotation. If all values of `cost` are 1, abs(w) is
a time, and the solution is the plan of minimum time. The solution uses at most as many rotations as
there are rows.

The solver is a revised simplex method that stores the inverse of the basis. Because the signs of w
are free, any basis is a feasible start. For example, the basis of the last cycle is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import _kernels

PERTURBATION = 1e-9
"""Size of a perturbation of the right-hand side, as a fraction of its largest entry. The
perturbation prevents ties between rows."""


@dataclass(frozen=True)
class TimeFractions:
    """Solution of the linear programme.

    Attributes
    ----------
    weights : (K,)
        Signed fractions of time of the rotations. At most R of them are not zero.
    price : (R,)
        Dual solution y: the additional cost per unit of each row's right-hand side. Any motion that
        is composed of these columns and produces b has at least the cost y . b.
    cost : float
        Value of the objective, which equals y . b.
    basis : (R,)
        Indices of the columns in the basis of the solution. The basis is a start for the next
        problem. With K columns and R rows, index K + i is the unmet amount of row i, and index K +
        R + i is its exceeded amount.
    pivots : int
        Number of pivots. If the number reached its maximum, the solution is feasible, but not
        optimal.
    """

    weights: np.ndarray
    price: np.ndarray
    cost: float
    basis: np.ndarray
    pivots: int


def min_time(
    matrix: np.ndarray,
    right_side: np.ndarray,
    cost: np.ndarray,
    miss_cost: np.ndarray,
    start: np.ndarray | None = None,
    pivots: int = 2000,
) -> TimeFractions:
    """Solve the linear programme.

    Parameters
    ----------
    matrix : (R, K)
        Matrix of the rotations, for example `rotation_matrix`.
    right_side : (R,)
        Right-hand side b.
    cost : (K,)
        Cost of each column, above 0.
    miss_cost : (R,)
        Cost per unit of the difference between A w and b in each row, at least 0.
    start : (R,), optional
        Basis of the solution of an earlier problem of the same size.
    pivots : int
        Maximum number of pivots.
    """
    rows, count = matrix.shape
    matrix = np.ascontiguousarray(matrix, dtype=float)
    right_side = np.array(right_side, dtype=float)
    price = np.concatenate([cost, miss_cost, miss_cost]).astype(float)
    # The fractional part of a multiple of the golden ratio gives each row a different shift.
    scale = max(float(np.max(np.abs(right_side), initial=0.0)), 1e-12)
    shift = PERTURBATION * scale * (1 + (np.arange(1, rows + 1) * 0.6180339887498949) % 1)
    shifted = right_side + np.where(right_side < 0, -shift, shift)
    basis = np.arange(count, count + rows)
    sense, used = np.ones(rows), -1
    if start is not None and len(start) == rows:
        basis = np.array(start)
        used = _kernels.simplex(matrix, shifted, price, basis, sense, pivots)
    if used < 0:  # there is no start basis, or its columns are linearly dependent
        basis = np.arange(count, count + rows)
        used = _kernels.simplex(matrix, shifted, price, basis, sense, pivots)
    inside = basis < count
    chosen = np.zeros((rows, rows))
    chosen[:, inside] = matrix[:, basis[inside]]
    slack = basis[~inside] - count
    chosen[slack % rows, ~inside] = np.where(slack < rows, 1.0, -1.0)
    amount = np.linalg.solve(chosen, right_side)
    weights = np.zeros(count)
    weights[basis[inside]] = amount[inside]
    signed = price[basis] * sense
    return TimeFractions(
        weights=weights,
        price=np.linalg.solve(chosen.T, signed),
        cost=float(signed @ amount),
        basis=basis,
        pivots=used,
    )
