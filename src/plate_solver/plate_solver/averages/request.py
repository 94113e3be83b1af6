"""A request for average forces on parts. `Request.check` raises an error if a shape or a value is
wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from plate_core import PlateError

from .. import _kernels
from ..library import CURL_LENGTH_M

FARTHEST_M: float = _kernels.FARTHEST_M
"""Maximum accepted coordinate of a part [m]."""

FASTEST_MPS: float = _kernels.FASTEST_MPS
"""Maximum accepted velocity of a part [m/s]."""


class RequestFlags(NamedTuple):
    """Properties of a request. C++ code computes all of them in one pass, because the same checks
    in numpy would take longer than a search from a good start.

    Attributes
    ----------
    is_valid : bool
        Whether all values are allowed.
    parts_move : bool
        Whether any part moves.
    has_curl : bool
        Whether any curl is requested.
    has_tolerance : bool
        Whether any force has a tolerance above 0.
    zero_is_enough : bool
        Whether zero force is within the tolerances of all parts.
    max_force : float
        Requested force minus its tolerance [mu m g], maximum over all parts.
    """

    is_valid: bool
    parts_move: bool
    has_curl: bool
    has_tolerance: bool
    zero_is_enough: bool
    max_force: float


def request_flags(
    position: np.ndarray,
    force: np.ndarray,
    velocity: np.ndarray,
    curl: np.ndarray,
    tolerance: np.ndarray,
) -> RequestFlags:
    """Compute the properties of a request."""
    return RequestFlags(*_kernels.request_flags(position, force, velocity, curl, tolerance))


@dataclass(frozen=True)
class Request:
    """Checked request for M parts.

    Attributes
    ----------
    position, force, velocity : (M, 2)
        Positions [m, plate_home], requested forces [mu m g] and velocities [m/s] of the parts.
    curl : (M,)
        Requested curls of the friction field at the parts [mu m g / m]. NaN accepts any curl.
    tolerance : (M, 2)
        Tolerances of the forces [mu m g]. Errors within +-tolerance count as 0.
    """

    position: np.ndarray
    force: np.ndarray
    velocity: np.ndarray
    curl: np.ndarray
    tolerance: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """Mask (3 M,) that states which components are requested. The components are force x, force
        y and curl of each part."""
        mask = np.ones((len(self.position), 3), bool)
        mask[:, 2] = np.isfinite(self.curl)
        return mask.ravel()

    @property
    def requested(self) -> np.ndarray:
        """Requested force x, force y and curl of part 1, then of part 2, and so on (3 M,)."""
        return np.column_stack([self.force, self.curl]).ravel()

    @property
    def scale(self) -> np.ndarray:
        """Factors (3 M,) that convert errors of the components in `requested` to force errors [mu m
        g]."""
        return np.tile([1.0, 1.0, CURL_LENGTH_M], len(self.position))

    @cached_property
    def flags(self) -> RequestFlags:
        """Properties of this request."""
        return request_flags(self.position, self.force, self.velocity, self.curl, self.tolerance)

    @property
    def idle(self) -> bool:
        """Whether a plate at rest meets the request."""
        return self.flags.zero_is_enough and not self.must_move

    @property
    def must_move(self) -> bool:
        """Whether only a moving plate can meet the request. A plate at rest brakes moving parts,
        and its friction field has no curl."""
        return self.flags.parts_move or self.flags.has_curl

    def scaled(self, fraction: float) -> Request:
        """Return the request with forces and curls multiplied by a fraction."""
        return replace(self, force=fraction * self.force, curl=fraction * self.curl)

    @classmethod
    def check(
        cls,
        position: np.ndarray,
        force: np.ndarray,
        velocity: np.ndarray | None,
        curl: np.ndarray | None,
        tolerance: np.ndarray | None = None,
    ) -> Request:
        """Check the shapes and values of a request, and return it.

        Raises
        ------
        PlateError
            If an array does not have the shape (M, 2), or (M,) for the curl, or if a value is not
            finite or is outside its range.
        """
        # the C++ kernels need this memory layout
        position = np.array(position, dtype=float, order="C")
        if position.ndim != 2 or position.shape[1] != 2 or not len(position):
            raise PlateError(f"position has shape {position.shape}, allowed: (M, 2), M at least 1")
        count = len(position)
        force = np.array(force, dtype=float, order="C")
        velocity, tolerance = (
            np.zeros((count, 2)) if array is None else np.array(array, dtype=float, order="C")
            for array in (velocity, tolerance)
        )
        curl = np.full(count, np.nan) if curl is None else np.array(curl, dtype=float)
        for name, array in (("force", force), ("velocity", velocity), ("tolerance", tolerance)):
            if array.shape != (count, 2):
                raise PlateError(f"{name} has shape {array.shape}, allowed: ({count}, 2)")
        if curl.shape != (count,):
            raise PlateError(f"curl has shape {curl.shape}, allowed: ({count},)")
        request = cls(position, force, velocity, curl, tolerance)
        if not request.flags.is_valid:
            request._refuse()
        return request

    def _refuse(self) -> None:
        """Raise an error that names the first invalid value and the allowed range."""
        limits = {"position": FARTHEST_M, "force": np.inf, "velocity": FASTEST_MPS}
        for name, limit in limits.items():
            array = getattr(self, name)
            size = np.abs(array)
            worst = float(size.max())
            if not worst < np.inf:
                raise PlateError(f"{name} has values that are not finite")
            if worst > limit:
                value = array.flat[np.argmax(size)]
                raise PlateError(f"{name} has value {value:g}, allowed: {-limit:g} to {limit:g}")
        if np.isinf(self.curl).any():
            raise PlateError(
                "curl has infinite values, allowed: finite numbers, or NaN for any curl"
            )
        raise PlateError("tolerance has values below 0 or NaN, allowed: 0 and above")
