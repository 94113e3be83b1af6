"""Reader of YAML files in config/, with a precise error message for each wrong value.

A `Key` defines the name, kind, meaning and default of one value. The reader of the file and the
generated reference (docs/reference.md) use the same definitions. `Fields` wraps one mapping of a
file and checks type and range at each access. `read_yaml` returns the `Fields` of a whole file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import re
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
import yaml

from .errors import PlateError, did_you_mean
from .files import YAML_BYTES, read_file

__all__ = [
    "REQUIRED",
    "Choice",
    "Fields",
    "Flag",
    "Key",
    "Kind",
    "List",
    "Number",
    "Numbers",
    "Section",
    "Table",
    "Text",
    "Whole",
    "did_you_mean",
    "keys_of",
    "measured",
    "parse_yaml", "read_yaml", "required",
]  # fmt: skip

Data = TypeVar("Data")

REQUIRED: Any = object()
"""Value of `Key.default` that marks a required key, which the file must contain."""

FAST_LENGTH = 20_000
"""Maximum length of a text that libyaml parses [characters]. libyaml is recursive, so deep nesting
in a longer text could exhaust the stack."""

UNITS = {
    "m": "m", "kg": "kg", "s": "s", "mps": "m/s", "mps2": "m/s^2", "n": "N", "k": "K", "px": "px",
    "deg": "degrees", "hz": "Hz", "kgm2": "kg m^2", "npm": "N/m", "nspm": "N s/m",
}  # fmt: skip
"""Units, by the last word of a key's name."""


SHOWN = reprlib.Repr()
"""Formatter that converts a value to text for a message, shortened to about one line."""
SHOWN.maxlevel = 3
SHOWN.maxlist = 8
SHOWN.maxstring = 80
SHOWN.maxother = 80


class Kind(Protocol):
    """Type and range of the value of a key."""

    @property
    def description(self) -> str:
        """Description of the allowed values, for messages and for the reference."""
        ...

    def read(self, value: Any) -> Any:
        """Return the checked value. Raise a ValueError if the value is not allowed."""
        ...


@dataclass(frozen=True)
class Number:
    """A finite number in [low, high]."""

    low: float
    high: float

    @property
    def description(self) -> str:
        """Description of the allowed values."""
        return f"a number from {self.low:g} to {self.high:g}"

    def read(self, value: Any) -> float:
        """Return the checked value as a float."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError
        if not self.low <= value <= self.high:  # this condition also refuses NaN
            raise ValueError
        return float(value)


@dataclass(frozen=True)
class Whole:
    """A whole number in [low, high]."""

    low: int
    high: int

    @property
    def description(self) -> str:
        """Description of the allowed values."""
        return f"a whole number from {self.low} to {self.high}"

    def read(self, value: Any) -> int:
        """Return the checked value."""
        if isinstance(value, bool) or not isinstance(value, int):
            raise ValueError
        if not self.low <= value <= self.high:
            raise ValueError
        return value


@dataclass(frozen=True)
class Sign:
    """1 or -1."""

    description: ClassVar[str] = "1 or -1"

    def read(self, value: Any) -> int:
        """Return the checked value."""
        if isinstance(value, bool) or value not in (1, -1):
            raise ValueError
        return int(value)


@dataclass(frozen=True)
class _OfType:
    """Any value of one Python type."""

    description: str
    python_type: ClassVar[type]

    def read(self, value: Any) -> Any:
        """Return the checked value."""
        if not isinstance(value, self.python_type):
            raise ValueError
        return value


@dataclass(frozen=True)
class Flag(_OfType):
    """True or false."""

    description: str = "true or false"
    python_type = bool


@dataclass(frozen=True)
class Text(_OfType):
    """Any text."""

    description: str = "a text"
    python_type = str


@dataclass(frozen=True)
class Table(_OfType):
    """A mapping. A separate section defines its keys."""

    description: str = "a mapping"
    python_type = Mapping


@dataclass(frozen=True)
class List(_OfType):
    """A list of mappings. A separate section defines their keys."""

    description: str = "a list of mappings"
    python_type = list


@dataclass(frozen=True)
class Choice:
    """One text out of a fixed set of texts."""

    choices: Sequence[str]

    @property
    def description(self) -> str:
        """Description of the allowed values."""
        return "one of " + ", ".join(self.choices)

    def read(self, value: Any) -> str:
        """Return the checked value."""
        if not isinstance(value, str) or value not in self.choices:
            raise ValueError
        return value


@dataclass(frozen=True)
class Numbers:
    """An array of finite numbers in [low, high]. None in the shape allows any length of this
    axis."""

    shape: tuple[int | None, ...]
    low: float
    high: float

    @property
    def description(self) -> str:
        """Description of the allowed values."""
        size = " x ".join("n" if n is None else str(n) for n in self.shape)
        return f"{size} numbers from {self.low:g} to {self.high:g}"

    def read(self, value: Any) -> np.ndarray:
        """Return the checked value as an array."""
        try:
            array = np.array(value, dtype=float)
        except (TypeError, OverflowError, RecursionError):
            raise ValueError from None
        fits = array.ndim == len(self.shape) and all(
            n is None or n == m for n, m in zip(self.shape, array.shape, strict=True)
        )
        if not fits or not np.all((array >= self.low) & (array <= self.high)):
            raise ValueError
        # refuse booleans and strings, because NumPy converts true to 1 and '2' to 2
        if any(isinstance(entry, bool | str) for entry in np.array(value, dtype=object).ravel()):
            raise ValueError
        return array


@dataclass(frozen=True)
class Several:
    """A list of up to `max_count` arrays."""

    each: Numbers
    max_count: int

    @property
    def description(self) -> str:
        """Description of the allowed values."""
        return f"a list of up to {self.max_count}, each {self.each.description}"

    def read(self, value: Any) -> list[np.ndarray]:
        """Return the checked values as arrays."""
        if not isinstance(value, list) or len(value) > self.max_count:
            raise ValueError
        return [self.each.read(item) for item in value]


@dataclass(frozen=True)
class Key:
    """One key of a file.

    Attributes
    ----------
    name : str
        Name with the unit as its last word, such as `radius_m`.
    kind : Kind
        Type and range of the value.
    meaning : str
        Explanation for the user, one sentence.
    default
        Value if the file does not contain the key. REQUIRED: the file must contain the key.
    otherwise : str
        Description of the default, if its value is not self-explanatory.
    """

    name: str
    kind: Kind
    meaning: str
    default: Any = REQUIRED
    otherwise: str = ""

    @property
    def required(self) -> bool:
        """Whether the file must contain the key."""
        return self.default is REQUIRED

    @property
    def unit(self) -> str:
        """Unit of the numbers. `-` for dimensionless numbers, empty if the kind has no numbers."""
        if not isinstance(self.kind, Number | Numbers | Several | Whole):
            return ""
        if self.name.endswith("_per_m"):
            return "1/m"
        return UNITS.get(self.name.rsplit("_", 1)[-1] if "_" in self.name else "", "-")


@dataclass(frozen=True)
class Section:
    """A mapping in a file: its location `where`, an introduction `about`, and its keys."""

    where: str
    about: str
    keys: tuple[Key, ...]

    def __getitem__(self, name: str) -> Key:
        return next(key for key in self.keys if key.name == name)


def measured(name: str, low: float, high: float, meaning: str, default: Any = REQUIRED) -> Any:
    """Return a dataclass field for `Fields.read`. The value of the field is a number in [low, high]
    from the key `name`."""
    key = Key(name, Number(low, high), meaning, default)
    missing = dataclasses.MISSING if key.required else default
    return dataclasses.field(default=missing, metadata={"key": key})


def keys_of(kind: type) -> tuple[Key, ...]:
    """Return the keys of a dataclass whose fields were created with `measured`."""
    return tuple(item.metadata["key"] for item in dataclasses.fields(kind))


class Fields:
    """One mapping of a YAML file. Every access checks type and range.

    Parameters
    ----------
    data : mapping
        Result of the YAML parser.
    where : str
        File and key path. Every message starts with this text.
    error : type
        Class of the errors that are raised.
    """

    def __init__(self, data: Any, where: str, error: type[PlateError]) -> None:
        if not isinstance(data, Mapping):
            raise error(f"{where}: got {SHOWN.repr(data)}, expected a mapping of keys to values")
        self._data = data
        self._where = where
        self._error = error
        self._used: set[str] = set()

    @property
    def where(self) -> str:
        """File and key path of this mapping."""
        return self._where

    @property
    def data(self) -> Mapping[str, Any]:
        """Unchecked content of the mapping."""
        return self._data

    def fail(self, key: str, allowed: str) -> PlateError:
        """Return an error about the value at `key`. The caller raises it."""
        value = SHOWN.repr(self._data.get(key))
        return self._error(f"{self._where}: {key} is {value}, allowed: {allowed}")

    def _required(self, key: str, allowed: str) -> Any:
        self._used.add(key)
        if key not in self._data:
            spare = [str(name) for name in self._data if name not in self._used]
            near = difflib.get_close_matches(key, spare, n=1)
            instead = f" (the file has {near[0]})" if near else ""
            raise self._error(f"{self._where}: {key} is missing, expected {allowed}{instead}")
        return self._data[key]

    def one_of(self, *keys: str) -> str:
        """Return the only key of `keys` that is present, and mark all of `keys` as known.

        Raises
        ------
        PlateError
            If none of the keys, or more than one, is present. If none is present, the message
            suggests a similar key of the file.
        """
        given = [key for key in keys if self.has(key)]
        if len(given) == 1:
            return given[0]
        if given:
            wrong = f"{' and '.join(given)} are given"
        else:
            spare = [str(name) for name in self._data if name not in self._used]
            near = next((name for name in spare if did_you_mean(name, keys)), "")
            hint = f"; found {near}{did_you_mean(near, keys)}" if near else ""
            wrong = f"{' or '.join(keys)} is missing{hint}"
        raise self._error(f"{self._where}: {wrong}, allowed: one of {', '.join(keys)}")

    def has(self, key: str) -> bool:
        """Return whether the optional key is present, and mark it as known."""
        self._used.add(key)
        return key in self._data

    def holds_mapping(self, key: str) -> bool:
        """Return whether the value at the key is a mapping."""
        return isinstance(self._data.get(key), Mapping)

    def holds_list(self, key: str) -> bool:
        """Return whether the value at the key is a list."""
        return isinstance(self._data.get(key), list)

    def keys(self) -> tuple[str, ...]:
        """Return the mapping's keys in the order of the file, and mark all of them as known."""
        self._used.update(self._data)
        return tuple(str(key) for key in self._data)

    def value(self, key: Key) -> Any:
        """Return the checked value of a key, or its default if the file does not contain it."""
        self._used.add(key.name)
        if not key.required and key.name not in self._data:
            return key.default
        value = self._required(key.name, key.kind.description)
        try:
            return key.kind.read(value)
        except ValueError:
            raise self.fail(key.name, key.kind.description) from None

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Return a finite number in [low, high]."""
        return float(self.value(_undescribed_key(key, Number(low, high), default)))

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return a whole number in [low, high]."""
        return int(self.value(_undescribed_key(key, Whole(low, high), default)))

    def flag(self, key: str) -> bool:
        """Return a boolean."""
        return bool(self.value(_undescribed_key(key, Flag())))

    def text(self, key: str, choices: Sequence[str] | None = None) -> str:
        """Return a string, one of `choices` if given."""
        return str(self.value(_undescribed_key(key, Choice(choices) if choices else Text())))

    def array(self, key: str, shape: tuple[int | None, ...], low: float, high: float) -> np.ndarray:
        """Return an array of finite numbers in [low, high]. None in `shape` allows any length."""
        return np.asarray(self.value(_undescribed_key(key, Numbers(shape, low, high))))

    def child(self, key: str) -> Fields:
        """Return the mapping at `key`."""
        return Fields(self._required(key, "a mapping"), f"{self._where}: {key}", self._error)

    def children(self, key: str) -> list[Fields]:
        """Return the mappings of the list at `key`."""
        value = self.value(_undescribed_key(key, List()))
        return [
            Fields(item, f"{self._where}: {key}[{i}]", self._error) for i, item in enumerate(value)
        ]

    def read(self, kind: type[Data]) -> Data:
        """Return an instance of a dataclass whose fields were created with `measured`. Other keys
        in the mapping are refused."""
        items = dataclasses.fields(kind)  # type: ignore[arg-type]
        values = {item.name: self.value(item.metadata["key"]) for item in items}
        self.finish()
        return kind(**values)

    def finish(self) -> None:
        """Raise an error if the mapping contains an unknown key, which is usually misspelled."""
        unknown = [str(key) for key in self._data if key not in self._used]
        if unknown:
            known = sorted(self._used)
            raise self._error(
                f"{self._where}: unknown key {unknown[0]}{did_you_mean(unknown[0], known)}, "
                f"allowed: {', '.join(known)}"
            )


def required(key: Key) -> Key:
    """Return a copy of the key that the file must contain."""
    return dataclasses.replace(key, default=REQUIRED)


def _undescribed_key(name: str, kind: Kind, default: Any = None) -> Key:
    """Return a key without a description, which docs/reference.md does not list. If `default` is
    None, the key is required."""
    return Key(name, kind, "", REQUIRED if default is None else default)


def read_yaml(path: str | Path, error: type[PlateError]) -> Fields:
    """Return the top-level mapping of a YAML file. If the file cannot be read or is invalid, an
    exception of the class `error` with a one-line message is raised."""
    return parse_yaml(read_file(path, YAML_BYTES, error), path, error)


def parse_yaml(content: bytes, path: str | Path, error: type[PlateError]) -> Fields:
    """Return the top-level mapping of YAML content, like `read_yaml`. The path is only used in
    messages."""
    path = Path(path)
    try:
        data, mistake = _load(content.decode("utf-8"))
    except UnicodeDecodeError as problem:
        raise error(f"{path}: is no text in UTF-8 ({problem}), allowed: UTF-8") from None
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f" at line {mark.line + 1}" if mark is not None else ""
        reason = getattr(problem, "problem", None) or "no valid YAML"
        raise error(f"{path}: broken YAML{line}: {reason}") from None
    except RecursionError:
        raise error(f"{path}: broken YAML: nested too deeply") from None
    # PyYAML raises these errors for an escape sequence beyond the range of Unicode.
    except (ValueError, OverflowError) as problem:
        raise error(f"{path}: broken YAML: {problem}") from None
    if mistake:
        raise error(f"{path.name}: {mistake}")
    return Fields(data, path.name, error)


def _load(text: str) -> tuple[Any, str]:
    """Return the content of a YAML text, and the result of `_find_mistake` for it.

    libyaml reads the content, because it is ten times as fast as PyYAML's own parser. If libyaml
    fails, or if the text is long, PyYAML's own parser reads the content. PyYAML's parser produces
    the error messages, and accepts any depth of nesting.
    """
    if len(text) <= FAST_LENGTH:
        with contextlib.suppress(yaml.YAMLError, ValueError):
            return _load_with(_FastLoader(text))
    return _load_with(_Loader(text))


def _load_with(loader: Any) -> tuple[Any, str]:
    node = loader.get_single_node()
    mistake = _find_mistake(node, set())
    return None if node is None else loader.construct_document(node), mistake


class _Values:
    """A YAML loader with two changes. First, it reads 1e-3 as a number, although YAML 1.1 defines
    this notation as text. Second, it reports an impossible value, such as the date 2026-13-45, with
    the line number."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)  # type: ignore[misc]
        except (ValueError, KeyError, AttributeError):
            kind = node.tag.rsplit(":", 1)[-1]
            raise yaml.MarkedYAMLError(
                problem=f"{SHOWN.repr(node.value)} is no {kind}", problem_mark=node.start_mark
            ) from None


class _Loader(_Values, yaml.SafeLoader):
    pass


class _FastLoader(_Values, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    pass


for _loader in (_Loader, _FastLoader):
    _loader.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"[-+]?[0-9][0-9.]*[eE][-+]?[0-9]+$"),
        list("-+0123456789"),
    )


WITH_COMMA = re.compile(r"[-+]?\d+,\d+")
"""Pattern of a number with a decimal comma. YAML reads such a number as text. Inside braces, as in
`{mu: 0,3}`, YAML reads the number 0 and a key 3 without a value."""

NOT_DECIMAL = re.compile(r"[-+]?(?:0[0-7_]+|[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?)")
"""Pattern of a number that YAML 1.1 does not read as decimal: 0640 is octal, 416, and 2:30 has the
base 60, 150."""


def _find_mistake(node: yaml.Node | None, seen: set[yaml.Node], of: str = "file") -> str:
    """Return a message about the first decimal comma, the first number of another base, or the
    first key that occurs twice in one mapping, at any depth. The message is empty if the text
    contains none of these mistakes. PyYAML accepts them without an error.

    A node with several references (YAML aliases) is examined only once, even if it contains itself.
    `of` is the key whose value the node is.
    """
    if node is None or node in seen:
        return ""
    seen.add(node)
    if isinstance(node, yaml.SequenceNode):
        return next(filter(None, (_find_mistake(item, seen, of) for item in node.value)), "")
    if isinstance(node, yaml.ScalarNode):
        is_number = node.tag.rsplit(":", 1)[-1] in ("int", "float")
        if not is_number or not NOT_DECIMAL.fullmatch(node.value):
            return ""
        line, value = node.start_mark.line + 1, yaml.safe_load(node.value)
        return (
            f"{of} is {node.value} at line {line}, which YAML reads as {value:g}, "
            "allowed: a decimal number without leading zeros and colons"
        )
    if not isinstance(node, yaml.MappingNode):
        return ""
    lines: dict[str, int] = {}
    before = "", ""
    for key, value in node.value:
        line, name = key.start_mark.line + 1, str(key.value)
        text = value.value if isinstance(value, yaml.ScalarNode) else "-"
        named, number = (name, text) if text else (before[0], f"{before[1]},{name}")
        if WITH_COMMA.fullmatch(number):
            point = number.replace(",", ".")
            return f"{named} is {number} at line {line}, allowed: a decimal point, {point}"
        before = name, text
        if name in lines:
            return f"key {name} occurs twice, at line {lines[name]} and at line {line}; remove one"
        lines[name] = line
        mistake = _find_mistake(value, seen, name)
        if mistake:
            return mistake
    return ""


CONFIG = Path(__file__).parent / "config"
"""The folder config/. In the source tree, this folder is a symbolic link. In an installed package,
it is a copy."""


def config_path(name: str) -> Path:
    """Return the path of a file or folder of config/.

    Raises
    ------
    PlateError
        If the file or folder does not exist.
    """
    path = CONFIG / name
    if not path.exists():
        raise PlateError(f"config file {name} does not exist in {CONFIG}")
    return path
