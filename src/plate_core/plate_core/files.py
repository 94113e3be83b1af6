"""Files that a user names: read only if they are regular, and no larger than such files are;
written whole or not at all.

A FIFO would keep its reader waiting, and a device or a wrong file fill the memory.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from .errors import PlateError

__all__ = ["YAML_BYTES", "check_file", "draft", "kind_of", "read_file"]

YAML_BYTES = 250_000
"""Most in a YAML file: sixty taught types take 100 kB, and more takes seconds to parse."""

KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


def read_file(path: str | Path, most_bytes: int, error: type[PlateError] = PlateError) -> bytes:
    """Return what is in a regular file, or in one that a link leads to.

    Parameters
    ----------
    path : path
    most_bytes : int
        No file that is meant is larger.
    error : type
        The error to raise.

    Raises
    ------
    PlateError
        If it is not there, of another kind, or larger: at once, and the message names the path,
        what it is and what is allowed.
    """
    check_file(path, most_bytes, error)  # before it is opened: to open a device may start it
    with (
        _explained(path, error),
        open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file,
    ):
        _check(path, os.fstat(file.fileno()), most_bytes, error)  # that it still is
        data = file.read(most_bytes + 1) or b""  # files of /proc do not tell their size
    if len(data) > most_bytes:
        raise error(f"{path}: has no end, allowed: {_allowed(most_bytes)}")
    return data


def kind_of(path: str | Path) -> str:
    """Say what is at a path, or what a link there leads to: `a file`, `a folder`, `a FIFO`,
    `a socket` or `a device`; empty if nothing is, or it cannot be told."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return ""
    return KINDS.get(stat.S_IFMT(found.st_mode), "a file")


def check_file(path: str | Path, most_bytes: int, error: type[PlateError] = PlateError) -> None:
    """Refuse what `read_file` does, for a library that opens the file by itself."""
    with _explained(path, error):
        _check(path, os.stat(path), most_bytes, error)


@contextlib.contextmanager
def _explained(path: str | Path, error: type[PlateError]) -> Iterator[None]:
    try:
        yield
    except PlateError:
        raise
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, ValueError) as problem:  # the latter: no path
        raise error(f"{path}: cannot be read ({problem})") from None


def _check(
    path: str | Path, found: os.stat_result, most_bytes: int, error: type[PlateError]
) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        raise error(f"{path}: is {KINDS.get(kind, 'no file')}, allowed: {_allowed(most_bytes)}")
    if found.st_size > most_bytes:
        size = f"{found.st_size / 1e6:.4g} MB"
        raise error(f"{path}: is of {size}, allowed: {_allowed(most_bytes)}")


def _allowed(most_bytes: int) -> str:
    return f"a regular file up to {most_bytes / 1e6:g} MB"


@contextlib.contextmanager
def draft(path: str | Path, what: str, keeps: bool = True) -> Iterator[BinaryIO]:
    """Open a file beside `path`, which takes its place once all is on the disk, if `keeps`; else,
    and after an error, it is removed.

    Raises
    ------
    PlateError
        If it cannot be written: names `what` it is and the path.
    """
    path = Path(path)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with beside.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if keeps:
            beside.replace(path)
    except OSError as error:
        raise PlateError(f"{what} {path}: cannot be written ({error})") from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
