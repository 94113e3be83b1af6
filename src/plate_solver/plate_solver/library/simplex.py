"""Fractions of time: a linear programme that picks few rotations out of many.

    minimise    cost . |w| + over . s + under . r
    subject to  A w + s - r = b,    s, r >= 0

Columns of A are rotations, rows what is asked of them; a negative weight turns the other way. s
and r are what is missed, each at its price. With costs of one, |w| is time, and the solution is the
plan of least time; it uses at most as many rotations as there are rows. Solved by the revised
simplex method with the inverse of the basis at hand: as the signs of w are free, any basis is a
feasible start, the last cycle's above all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import _kernels

PERTURBATION = 1e-9
"""Shift of the right-hand side, relative to its greatest entry, that breaks ties between rows."""


@dataclass(frozen=True)
class TimeFractions:
    """Solution of the linear programme.

    Attributes
    ----------
    weights : (K,)
        Signed fractions of time of the columns, at most R of them not zero.
    miss : (R,)
        b - A w.
    price : (R,)
        Dual solution y: what a unit more of each row would cost. No motion that these columns are
        made of can do b for less than y . b.
    cost : float
        Value of the objective; equals y . b.
    basis : (R,)
        Columns of the solution (K + r, K + R + r for what row r misses): a start for the next.
    pivots : int
    optimal : bool
        False if the pivots ran out first; the solution is feasible all the same.
    """

    weights: np.ndarray
    miss: np.ndarray
    price: np.ndarray
    cost: float
    basis: np.ndarray
    pivots: int
    optimal: bool


def least_time(
    matrix: np.ndarray,
    wanted: np.ndarray,
    cost: np.ndarray,
    over: np.ndarray,
    under: np.ndarray,
    start: np.ndarray | None = None,
    pivots: int = 2000,
) -> TimeFractions:
    """Solve the linear programme.

    Parameters
    ----------
    matrix : (R, K)
        Rows such as those of `rotation_matrix`.
    wanted : (R,)
        Right-hand side b.
    cost : (K,)
        Cost of each column, above zero.
    over, under : (R,)
        Price of getting less and of getting more than is wanted, not negative.
    start : (R,), optional
        Basis of an earlier solution of a problem of this size.
    pivots : int
        Most pivots.
    """
    rows, count = matrix.shape
    matrix = np.ascontiguousarray(matrix, dtype=float)
    wanted = np.array(wanted, dtype=float)
    price = np.concatenate([cost, over, under]).astype(float)
    # Golden-ratio fractions: no two rows are shifted alike.
    scale = max(float(np.max(np.abs(wanted), initial=0.0)), 1e-12)
    shift = PERTURBATION * scale * (1 + (np.arange(1, rows + 1) * 0.6180339887498949) % 1)
    shifted = wanted + np.where(wanted < 0, -shift, shift)
    basis = np.arange(count, count + rows)
    sense, used = np.ones(rows), -1
    if start is not None and len(start) == rows:
        basis = np.array(start)
        used = _kernels.simplex(matrix, shifted, price, basis, sense, pivots)
    if used < 0:  # no start, or one whose columns have become dependent
        basis = np.arange(count, count + rows)
        used = _kernels.simplex(matrix, shifted, price, basis, sense, pivots)
    chosen = _kernels.columns_of(matrix, basis)
    amount = np.linalg.solve(chosen, wanted)
    inside = basis < count
    weights = np.zeros(count)
    weights[basis[inside]] = amount[inside]
    signed = price[basis] * sense
    return TimeFractions(
        weights=weights,
        miss=wanted - matrix @ weights,
        price=np.linalg.solve(chosen.T, signed),
        cost=float(signed @ amount),
        basis=basis,
        pivots=used,
        optimal=used < pivots,
    )
