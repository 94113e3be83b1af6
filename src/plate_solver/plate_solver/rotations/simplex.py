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

from plate_core.kernels import SAME_ROUNDING, kernel

PERTURBATION = 1e-9
"""Shift of the right-hand side, relative to its greatest entry, that breaks ties between rows."""

OPTIMAL = 1e-9
"""Gain per unit below which a column counts as of no use, in units of cost."""

PIVOT = 1e-9
"""Least size of a pivot; and of 1 over the greatest entry of an inverse."""

REFRESH = 40
"""Pivots after which the inverse of the basis is computed anew."""


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
        used = _simplex(matrix, shifted, price, basis, sense, pivots)
    if used < 0:  # no start, or one whose columns have become dependent
        basis = np.arange(count, count + rows)
        used = _simplex(matrix, shifted, price, basis, sense, pivots)
    chosen = _columns(matrix, basis)
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


@kernel()
def _columns(matrix: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return the columns (R, R) of a basis."""
    rows, count = matrix.shape
    chosen = np.zeros((rows, rows))
    for j in range(rows):
        q = basis[j]
        if q < count:
            for i in range(rows):
                chosen[i, j] = matrix[i, q]
        elif q < count + rows:
            chosen[q - count, j] = 1.0
        else:
            chosen[q - count - rows, j] = -1.0
    return chosen


@kernel()
def _restart(
    matrix: np.ndarray, wanted: np.ndarray, basis: np.ndarray, sense: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return inverse and amounts (not negative) of a basis, and whether it serves; fills `sense`.

    What would be negative turns the other way: a rotation changes its sense, a miss its side.
    """
    rows, count = matrix.shape
    chosen = _columns(matrix, basis)
    inverse, fits = np.eye(rows), True
    try:
        inverse = np.ascontiguousarray(np.linalg.inv(chosen))
    except Exception:  # singular: the only kind that numba can name
        fits = False
    fits = fits and np.max(np.abs(inverse)) * PIVOT < 1
    amount = inverse @ wanted
    for i in range(rows):
        sense[i] = 1.0
        if amount[i] < 0:
            amount[i] = -amount[i]
            inverse[i] = -inverse[i]
            if basis[i] < count:
                sense[i] = -1.0
            else:
                basis[i] += rows if basis[i] < count + rows else -rows
    return inverse, amount, fits


@kernel(fastmath=SAME_ROUNDING)
def _best_column(
    matrix: np.ndarray, dual: np.ndarray, price: np.ndarray, value: np.ndarray
) -> tuple[int, float, float]:
    """Return the column that pays most, its sense, and what it pays per unit."""
    rows, count = matrix.shape
    value[:] = 0.0
    for i in range(rows):
        y = dual[i]
        for j in range(count):
            value[j] += y * matrix[i, j]
    best, gain = -1, 0.0
    for j in range(count):
        if abs(value[j]) - price[j] > gain:
            best, gain = j, abs(value[j]) - price[j]
    sense = 1.0 if best < 0 or value[best] > 0 else -1.0
    for i in range(rows):
        if dual[i] - price[count + i] > gain:
            best, gain, sense = count + i, dual[i] - price[count + i], 1.0
        if -dual[i] - price[count + rows + i] > gain:
            best, gain, sense = count + rows + i, -dual[i] - price[count + rows + i], 1.0
    return best, sense, gain


@kernel()
def _simplex(
    matrix: np.ndarray, wanted: np.ndarray, price: np.ndarray, basis: np.ndarray,
    sense: np.ndarray, pivots: int,
) -> int:  # fmt: skip
    """Improve basis and senses in place; return the pivots made, -1 if it does not serve."""
    rows, count = matrix.shape
    inverse, amount, fits = _restart(matrix, wanted, basis, sense)
    value = np.empty(count)
    column = np.empty(rows)
    for done in range(pivots):
        if done % REFRESH == REFRESH - 1:
            inverse, amount, fits = _restart(matrix, wanted, basis, sense)
        if not fits:
            return -1
        q, way, gain = _best_column(matrix, price[basis] @ inverse, price, value)
        if gain <= OPTIMAL:
            return done
        if q < count:
            column[:] = way * (inverse @ np.ascontiguousarray(matrix[:, q]))
        elif q < count + rows:
            column[:] = inverse[:, q - count]
        else:
            column[:] = -inverse[:, q - count - rows]
        leave, amount_in = -1, np.inf
        for i in range(rows):
            if column[i] > PIVOT and amount[i] < amount_in * column[i]:
                amount_in, leave = amount[i] / column[i], i
        if leave < 0:
            return done  # unbounded: not with costs and prices as they may be
        for i in range(rows):
            if i != leave:
                amount[i] = max(amount[i] - amount_in * column[i], 0.0)
                part = column[i] / column[leave]
                if part != 0:
                    for c in range(rows):
                        inverse[i, c] -= part * inverse[leave, c]
        inverse[leave] /= column[leave]
        amount[leave] = amount_in
        basis[leave] = q
        sense[leave] = way
    return pivots
