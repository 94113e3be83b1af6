"""Files of config/: found, and read field by field, so that wrong ones are refused usefully."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from .errors import PlateError

__all__ = ["Fields", "read_yaml"]

Data = TypeVar("Data")


def measured(key: str, low: float, high: float, default: Any = dataclasses.MISSING) -> Any:
    """Return a dataclass field that `Fields.read` takes from `key`: a number in [low, high]."""
    return dataclasses.field(default=default, metadata={"key": key, "range": (low, high)})


class Fields:
    """One mapping of a YAML file; every access checks type and range.

    Parameters
    ----------
    data : mapping
        What the YAML parser returned.
    where : str
        File and key path, the beginning of every message.
    error : type
        The error to raise.
    """

    def __init__(self, data: Any, where: str, error: type[PlateError]) -> None:
        if not isinstance(data, Mapping):
            raise error(f"{where}: got {data!r}, expected a mapping of keys to values")
        self._data = data
        self._where = where
        self._error = error
        self._used: set[str] = set()

    @property
    def where(self) -> str:
        """File and key path of this mapping."""
        return self._where

    def fail(self, key: str, allowed: str) -> PlateError:
        """Return the error for the value at `key`: the caller raises it."""
        return self._error(f"{self._where}: {key} is {self._data.get(key)!r}, allowed: {allowed}")

    def _get(self, key: str, allowed: str) -> Any:
        self._used.add(key)
        if key not in self._data:
            raise self._error(f"{self._where}: {key} is missing, expected {allowed}")
        return self._data[key]

    def has(self, key: str) -> bool:
        """Tell whether the optional key is present."""
        return key in self._data

    def holds_mapping(self, key: str) -> bool:
        """Tell whether there is a mapping at the key."""
        return isinstance(self._data.get(key), Mapping)

    def holds_list(self, key: str) -> bool:
        """Tell whether there is a list at the key."""
        return isinstance(self._data.get(key), list)

    def keys(self) -> tuple[str, ...]:
        """Return the mapping's keys, in the file's order, and count all of them as known."""
        self._used.update(self._data)
        return tuple(str(key) for key in self._data)

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Return a finite number in [low, high]."""
        allowed = f"a number from {low:g} to {high:g}"
        if default is not None and key not in self._data:
            return default
        value = self._get(key, allowed)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(key, allowed)
        if not math.isfinite(value) or not low <= value <= high:
            raise self.fail(key, allowed)
        return float(value)

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return a whole number in [low, high]."""
        allowed = f"a whole number from {low} to {high}"
        if default is not None and key not in self._data:
            return default
        value = self._get(key, allowed)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.fail(key, allowed)
        return value

    def flag(self, key: str) -> bool:
        """Return true or false."""
        value = self._get(key, "true or false")
        if not isinstance(value, bool):
            raise self.fail(key, "true or false")
        return value

    def text(self, key: str, choices: Sequence[str] | None = None) -> str:
        """Return a string, one of `choices` if given."""
        allowed = "one of " + ", ".join(choices) if choices else "a text"
        value = self._get(key, allowed)
        if not isinstance(value, str) or (choices is not None and value not in choices):
            raise self.fail(key, allowed)
        return value

    def array(self, key: str, shape: tuple[int | None, ...], low: float, high: float) -> np.ndarray:
        """Return an array of finite numbers in [low, high]; None in `shape` is any length."""
        size = " x ".join("n" if n is None else str(n) for n in shape)
        allowed = f"{size} numbers from {low:g} to {high:g}"
        value = self._get(key, allowed)
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            raise self.fail(key, allowed) from None
        fits = array.ndim == len(shape) and all(
            n is None or n == m for n, m in zip(shape, array.shape, strict=True)
        )
        if not fits or not np.all((array >= low) & (array <= high)):
            raise self.fail(key, allowed)
        return array

    def child(self, key: str) -> Fields:
        """Return the mapping at `key`."""
        return Fields(self._get(key, "a mapping"), f"{self._where}: {key}", self._error)

    def children(self, key: str) -> list[Fields]:
        """Return the mappings of the list at `key`."""
        value = self._get(key, "a list of mappings")
        if not isinstance(value, list):
            raise self.fail(key, "a list of mappings")
        return [
            Fields(item, f"{self._where}: {key}[{i}]", self._error) for i, item in enumerate(value)
        ]

    def read(self, kind: type[Data]) -> Data:
        """Return a dataclass whose fields are `measured`; the mapping has no other keys."""
        values = {}
        for item in dataclasses.fields(kind):  # type: ignore[arg-type]
            default = None if item.default is dataclasses.MISSING else item.default
            key, (low, high) = item.metadata["key"], item.metadata["range"]
            values[item.name] = self.number(key, low, high, default)
        self.finish()
        return kind(**values)

    def finish(self) -> None:
        """Refuse keys that nobody asked for: most of them are spelling mistakes."""
        unknown = [str(key) for key in self._data if key not in self._used]
        if unknown:
            raise self._error(
                f"{self._where}: unknown key {unknown[0]}, allowed: {', '.join(sorted(self._used))}"
            )


def read_yaml(path: str | Path, error: type[PlateError]) -> Fields:
    """Return the top mapping of a YAML file; every failure is one clear line of type `error`."""
    path = Path(path)
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{path}: cannot be read ({problem})") from None
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f" at line {mark.line + 1}" if mark is not None else ""
        reason = getattr(problem, "problem", None) or "no valid YAML"
        raise error(f"{path}: broken YAML{line}: {reason}") from None
    return Fields(data, path.name, error)


CONFIGURED_BY = ("plate_core", "plate_bringup")
"""Packages that install files of config/."""


def config_path(name: str) -> Path:
    """Return the path of a file of config/, installed or in the source tree.

    Raises
    ------
    PlateError
        If it is in neither.
    """
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if p]
    places = [p / "share" / package / "config" for p in prefixes for package in CONFIGURED_BY]
    places += [parent / "config" for parent in Path(__file__).resolve().parents]
    for place in places:
        if (place / name).exists():
            return place / name
    raise PlateError(
        f"config file {name}: in no share/{' or share/'.join(CONFIGURED_BY)} of AMENT_PREFIX_PATH, "
        "nor in the source tree; are these packages installed and sourced?"
    )
