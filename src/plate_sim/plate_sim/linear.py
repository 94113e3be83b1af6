"""Exact motion of linear systems z' = A z + b(t), where b is a polynomial.

Over a step h, with b(t) = sum_k b_k t^k / k!,

    z(h) = phi_0(hA) z(0) + sum_k h^(k+1) phi_(k+1)(hA) b_k,
    phi_0(x) = exp(x),  phi_k(x) = 1/k! + x phi_(k+1)(x),

by variation of constants (Higham, Functions of Matrices, section 10.7.4).
"""

from __future__ import annotations

from math import factorial

import numpy as np
from scipy.linalg import matrix_balance

DEGREE = 5
"""Of b: forces for a quintic motion."""

SERIES_NORM = 0.25
"""Greatest norm of hA at which the power series is summed."""

SERIES_TERMS = 10
"""Terms of that series: the first left out is 1e-17 of the first."""


def rate(system: np.ndarray) -> float:
    """Bound [1/s] of how fast the system (n, n) goes, in its best units."""
    balanced, _ = matrix_balance(system, permute=False)
    return float(np.linalg.norm(balanced, 1))


def depth(system: np.ndarray, step: float) -> int:
    """How often `step` [s] must be halved until the system hardly turns within it."""
    return max(0, int(np.ceil(np.log2(max(rate(system) * step, 1e-300) / SERIES_NORM))))


def step_responses(system: np.ndarray, steps: np.ndarray, halvings: int) -> np.ndarray:
    """What a state and a polynomial input do over steps, and over their halves.

    Parameters
    ----------
    system : (n, n)
        A [1/s].
    steps : (u,)
        [s].
    halvings : int
        At least `depth(system, max(steps))`.

    Returns
    -------
    (halvings + 1, u, DEGREE + 2, n, n)
        At [l]: for steps / 2^l, phi_0 (hA) and h^(k+1) phi_(k+1)(hA), k = 0 .. DEGREE.
    """
    count, size = DEGREE + 2, len(system)
    phi = np.empty((halvings + 1, len(steps), count, size, size))
    phi[-1] = _series(system * (steps[:, None, None] / 2**halvings))
    for level in range(halvings - 1, -1, -1):
        _double(phi[level + 1], phi[level])
    spans = steps / 2.0 ** np.arange(halvings + 1)[:, None]
    return np.asarray(phi * (spans[..., None] ** np.arange(count))[..., None, None])


def advance(response: np.ndarray, state: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Return states (m, n) a step later.

    Parameters
    ----------
    response : (m, DEGREE + 2, n, n)
        Of `step_responses`, for each state's step.
    state : (m, n)
    derivatives : (m, DEGREE + 1, n)
        Of the input, at the step's start.
    """
    inputs = np.concatenate([state[:, None], derivatives], axis=1)
    return np.asarray((response @ inputs[..., None])[..., 0].sum(axis=1))


def _series(x: np.ndarray) -> np.ndarray:
    """phi_0 .. phi_(DEGREE+1) (u, DEGREE + 2, n, n) of matrices x (u, n, n) of small norm."""
    last = DEGREE + 1
    eye = np.eye(x.shape[1])
    total = np.zeros_like(x)
    for i in range(SERIES_TERMS - 1, -1, -1):
        total = eye / factorial(last + i) + x @ total
    phi = [total]
    for k in range(last - 1, -1, -1):
        phi.append(eye / factorial(k) + x @ phi[-1])
    return np.stack(phi[::-1], axis=1)


def _double(phi: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` with phi_k(2x) of phi_k(x) (u, DEGREE + 2, n, n)."""
    for k in range(phi.shape[1]):
        out[:, k] = phi[:, 0] @ phi[:, k]
        for j in range(1, k + 1):
            out[:, k] += phi[:, j] / factorial(k - j)
        out[:, k] /= 2**k


def later(derivatives: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return derivatives (m, DEGREE + 1, d) of polynomials, `offset` (m,) [s] later."""
    order = np.arange(DEGREE + 1)
    power = order - order[:, None]  # [i, j]: j - i, what derivative j adds to derivative i
    scale = np.array([1 / factorial(p) for p in order])[np.maximum(power, 0)] * (power >= 0)
    return np.asarray((scale * offset[:, None, None] ** np.maximum(power, 0)) @ derivatives)
