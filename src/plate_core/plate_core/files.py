"""Safe reading and writing of files that a user names.

`read_file` accepts only regular files up to a maximum size. A FIFO would block the reader, and a
device or a wrong file could fill the memory. `draft` writes a temporary file and then renames it,
so the target is either complete or unchanged. `OwnFile` does the same repeatedly, and no other
process can write its file at the same time.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from .errors import PlateError

__all__ = ["YAML_BYTES", "OwnFile", "check_file", "draft", "kind_of", "read_file"]

YAML_BYTES = 250_000
"""Maximum size of a YAML file [bytes]. Sixty taught part types need 100 kB; a larger file takes
seconds to parse."""

KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


def read_file(path: str | Path, max_bytes: int, error: type[PlateError] = PlateError) -> bytes:
    """Return the content of a regular file. Symbolic links are followed.

    Parameters
    ----------
    path : path
    max_bytes : int
        Maximum size of the file [bytes].
    error : type
        Class of the errors that the function raises.

    Raises
    ------
    PlateError
        If the file is missing, is not a regular file, or is too large. In these cases the function
        does not block. The message states the path, the kind or size, and what is allowed.
    """
    # Check the file before it is opened, because opening a device file may start the device.
    check_file(path, max_bytes, error)
    with (
        _convert_errors(path, error),
        open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file,
    ):
        # check again, because the file may have been replaced after the first check
        _check_file_size(path, os.fstat(file.fileno()), max_bytes, error)
        # the result of `read` can be larger than the reported size, for example in /proc
        data = file.read(max_bytes + 1) or b""
    if len(data) > max_bytes:
        raise error(f"{path}: its size is unlimited, allowed: {_allowed_text(max_bytes)}")
    return data


def kind_of(path: str | Path) -> str:
    """Return the kind of file at a path, after following links: `a file`, `a folder`, `a FIFO`,
    `a socket` or `a device`. The result is empty if the path does not exist or cannot be
    examined."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return ""
    return KINDS.get(stat.S_IFMT(found.st_mode), "a file")


def check_file(path: str | Path, max_bytes: int, error: type[PlateError] = PlateError) -> None:
    """Raise the same errors as `read_file`. Use this function before a library opens the file
    itself."""
    with _convert_errors(path, error):
        _check_file_size(path, os.stat(path), max_bytes, error)


@contextlib.contextmanager
def _convert_errors(path: str | Path, error: type[PlateError]) -> Iterator[None]:
    try:
        yield
    except PlateError:
        raise
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, ValueError) as problem:  # a ValueError means that the text is not a valid path
        raise error(f"{path}: cannot be read ({problem})") from None


def _check_file_size(
    path: str | Path, found: os.stat_result, max_bytes: int, error: type[PlateError]
) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        raise error(f"{path}: is {KINDS.get(kind, 'no file')}, allowed: {_allowed_text(max_bytes)}")
    if found.st_size > max_bytes:
        size = f"{found.st_size / 1e6:.4g} MB"
        raise error(f"{path}: has {size}, allowed: {_allowed_text(max_bytes)}")


def _allowed_text(max_bytes: int) -> str:
    return f"a regular file up to {max_bytes / 1e6:g} MB"


@contextlib.contextmanager
def draft(path: str | Path, what: str, keeps: bool = True) -> Iterator[BinaryIO]:
    """Open a temporary file in the folder of `path` for writing.

    When the context ends, the data are flushed to the disk. If `keeps` is True, the temporary file
    then replaces `path` and gets its permissions. If `keeps` is False or an error occurs, the
    temporary file is removed.

    Raises
    ------
    PlateError
        If the file cannot be written. The message contains `what` (the kind of data) and the path.
    """
    path = Path(path)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(beside, "wb", opener=lambda name, _: _create(Path(name))) as file:
            with contextlib.suppress(FileNotFoundError):
                shutil.copymode(path, beside)
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


class OwnFile:
    """File that only this process can write. The content of the file is complete at any time. A new
    file appears with its first content. The object is a context manager.

    Parameters
    ----------
    path : path
        A regular file, a new file, or a device such as /dev/stdout. Links are followed.

    Raises
    ------
    PlateError
        If another process has opened the file as `OwnFile`.
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        # /dev/stdout can be a link to a regular file that the shell has opened. A file that the
        # shell has opened must not be replaced.
        of_system = os.path.abspath(path).startswith(("/dev/", "/proc/"))
        self._path = Path(path)
        self._target = self._path if of_system else Path(os.path.realpath(path))
        self._draft = self._target.with_name(f"{self._target.name}.draft")
        self._is_new = False
        self._descriptor = self._open()
        is_file = self._is_new or stat.S_ISREG(os.fstat(self._descriptor).st_mode)
        self._is_replaceable = is_file and not of_system
        if self._is_replaceable:  # test whether files can be made in the folder
            try:
                os.close(_create(self._draft))
            except OSError:
                self.close()
                raise
            self._draft.unlink()

    def __enter__(self) -> OwnFile:
        return self

    def __exit__(
        self, kind: type | None, problem: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()

    def write(self, text: str) -> None:
        """Replace the content and keep the permissions. If an error occurs, the file stays
        unchanged."""
        if not self._is_replaceable:
            self._path.write_text(text, encoding="utf-8")
            return
        descriptor = _create(self._draft)
        try:
            _try_lock(descriptor)
            if not self._is_new:
                os.fchmod(descriptor, stat.S_IMODE(os.fstat(self._descriptor).st_mode))
            elif os.path.lexists(self._target):  # made without a lock, or on another computer
                raise PlateError(self._in_use())
            with open(descriptor, "w", encoding="utf-8", closefd=False) as file:
                file.write(text)
            self._draft.replace(self._target)
        except BaseException as problem:  # BaseException includes KeyboardInterrupt
            os.close(descriptor)
            with contextlib.suppress(OSError):
                self._draft.unlink()
            if isinstance(problem, OSError):  # name the file, for example if the disk is full
                problem.filename = str(self._path)
            raise
        os.close(self._descriptor)
        self._descriptor, self._is_new = descriptor, False

    def close(self) -> None:
        """Close the file, so that other processes can open it for writing."""
        os.close(self._descriptor)

    def _in_use(self) -> str:
        return (
            f"{self._path} is in use, because another process writes it, allowed: another file, or "
            "this file after that process has ended"
        )

    def _open(self) -> int:
        """Open and lock the file. If the file does not exist, lock its path, and set `_is_new`."""
        while True:
            if not os.path.lexists(self._target):
                descriptor = self._lock_path()
                self._is_new = not os.path.lexists(self._target)
                if self._is_new:
                    return descriptor
                os.close(descriptor)  # another process has made the file in the meantime
            descriptor = os.open(self._path, os.O_WRONLY | os.O_NONBLOCK)
            try:
                status = os.fstat(descriptor)
                is_locked = not stat.S_ISREG(status.st_mode) or _try_lock(descriptor)
                if is_locked and os.path.samestat(status, os.stat(self._path)):
                    return descriptor
                is_in_use = not is_locked
            except FileNotFoundError:
                is_in_use = False
            os.close(descriptor)
            if is_in_use:
                raise PlateError(self._in_use())
            # another process has replaced the file in the meantime, so open the new one

    def _lock_path(self) -> int:
        """Lock the path of a new file by an abstract socket (unix(7)) with a name that is derived
        from the path. If this process is killed, the kernel removes the socket. A file would
        remain."""
        name = hashlib.sha256(os.fsencode(self._target)).hexdigest()
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as lock:
            try:
                lock.bind(f"\0plate_core.files {name}")
            except OSError:
                raise PlateError(self._in_use()) from None
            return lock.detach()


def _create(path: Path) -> int:
    """Create a file and open it for writing. If the path exists, it is removed first. If it were
    opened instead, a link would change another file, and a FIFO could block."""
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)


def _try_lock(number: int) -> bool:
    """Try to lock an open file, without waiting. Return False only if another process holds the
    lock. On a file system without locks, return True. The lock ends when the file is closed."""
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # this file system does not support locks
        return True
    return True
