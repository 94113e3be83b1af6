"""A table of first guesses, as in section 3.2.3 and figure 13 of the paper.

Random motions are piped through the force map at random places; a k-d tree over place and force
finds the motions that did something like what is asked now. Tables are kept on disk.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from scipy.spatial import cKDTree

from plate_core import Rig

from .harmonic_force import forces, rules
from .harmonics import harmonics
from .solution import Bounds

SIZE = 20_000
"""Entries: a fifth of a second to make. More do not make better guesses for several parts."""

VERSION = 1
"""To be raised when the meaning or the making of a table's numbers changes."""

ANY_PERIOD = 1.0
"""Averaged forces do not depend on the period [s]."""


class GuessTable:
    """Motions by (place, force).

    Parameters
    ----------
    coefficients : (S, h, 3)
        Motions of a family.
    position : (S, 2)
        Places [m], plate_home.
    force : (S, 2)
        Their average forces there [mu m g].
    half : (2,)
        Half sides of the plate [m]: scale of places.
    """

    def __init__(
        self, coefficients: np.ndarray, position: np.ndarray, force: np.ndarray, half: np.ndarray
    ) -> None:
        self.coefficients, self.position, self.force = coefficients, position, force
        self._scale = np.concatenate([half, np.full(2, max(float(force.std()), 1e-12))])
        self._tree = cKDTree(np.hstack([position, force]) / self._scale)

    @classmethod
    def make(
        cls, rig: Rig, number: int, at_rest: bool, seed: int = 0, size: int = SIZE
    ) -> GuessTable:
        """Make a table for motions of `number` harmonics: the same seed makes the same table."""
        rng = np.random.default_rng(seed)
        basis, bounds = harmonics(number, ANY_PERIOD, at_rest), Bounds.of(rig)
        coefficients = rng.normal(size=(size, basis.size, 3))
        coefficients[:, :, 2] /= bounds.arm_m
        position = rng.uniform(-rig.plate.half, rig.plate.half, (size, 2))
        waves = np.einsum("jh,shc->sjc", basis.span, coefficients)
        force = forces(waves, position, np.zeros_like(position), rules(number))
        return cls(coefficients, position, force, rig.plate.half)

    def nearest(self, position: np.ndarray, force: np.ndarray, count: int = 1) -> list[np.ndarray]:
        """Return coefficients (h, 3) for the parts' mean place and mean force, best first.

        Parameters
        ----------
        position, force : (M, 2)
            [m] in plate_home, [mu m g].
        """
        query = np.concatenate([position.mean(axis=0), force.mean(axis=0)]) / self._scale
        _, index = self._tree.query(query, k=count)
        return [self.coefficients[i] for i in np.atleast_1d(index)]


def cache_folder() -> Path:
    """Return the folder of kept tables: in the user's cache."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "plate_solver"


def guess_table(
    rig: Rig, number: int, at_rest: bool, size: int = SIZE, folder: Path | None = None
) -> GuessTable:
    """Return a table from the cache, or make it and keep it there.

    A file that is none of ours, damaged or of another version is made anew; where nothing can be
    written, nothing is kept.
    """
    half, arm = rig.plate.half, Bounds.of(rig).arm_m
    mark = f"{VERSION} {number} {at_rest} {size} {half.tolist()} {arm!r}"
    name = hashlib.sha256(mark.encode()).hexdigest()[:16]
    path = (folder or cache_folder()) / f"guesses-{name}.npz"
    table = _load(path, mark, harmonics(number, ANY_PERIOD, at_rest).size, size, half)
    if table is None:
        table = GuessTable.make(rig, number, at_rest, size=size)
        with suppress(OSError):
            _save(path, mark, table)
    return table


def _load(path: Path, mark: str, rows: int, size: int, half: np.ndarray) -> GuessTable | None:
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            known = str(file["mark"]) == mark
            arrays = [file[key] for key in ("coefficients", "position", "force")]
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile):
        return None
    shapes = [(size, rows, 3), (size, 2), (size, 2)]
    fit = all(
        a.shape == shape and a.dtype == float and bool(np.all(np.isfinite(a)))
        for a, shape in zip(arrays, shapes, strict=True)
    )
    coefficients, position, force = arrays
    return GuessTable(coefficients, position, force, half) if known and fit else None


def _save(path: Path, mark: str, table: GuessTable) -> None:
    """Write whole or not at all: other programs may read at the same time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, draft = tempfile.mkstemp(dir=path.parent, suffix=".draft")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(
                file,
                mark=mark,
                coefficients=table.coefficients,
                position=table.position,
                force=table.force,
            )
        os.replace(draft, path)
    except OSError:
        Path(draft).unlink(missing_ok=True)
        raise
