"""What numba compiles, kept on disk until a source file of the kernel's package changes.

By itself numba looks only at the file that a kernel stands in, not at those from which it has other
kernels and constants. A kernel uses nothing of other packages, nor of a node.
"""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numba.core import caching, event

__all__ = ["SAME_ROUNDING", "constant", "inner_kernel", "kernel", "when_compiling"]

SAME_ROUNDING = {"nnan", "ninf", "nsz"}
"""Freedom of the compiler (`fastmath`) that changes no sum: a kernel rounds alike everywhere.

With all freedom it rounds by the width of the processor's vectors, and in each kernel that it is
put into in another way. Of such copies, which have one name, a process runs the one that it had
first: one that compiles them gives other numbers than one that loads them.
"""


def _kept() -> bool:
    """Whether there is a folder for compiled code: without one numba refuses to keep any."""
    try:
        njit(cache=True)(lambda: None)
    except RuntimeError:
        return False
    return True


kernel = partial(njit, cache=_kept())
"""Decorator of a function that numba compiles: `@kernel`, or with more options of `numba.njit`."""

inner_kernel: Any = partial(kernel, nogil=True, error_model="numpy", _nrt=False)
"""Decorator of a kernel that other kernels call and that makes no array.

numba then counts no references to its arrays: an atomic operation of 5 ns for each array at every
call, where a short kernel takes 20 ns in all.
"""


def constant(value: int) -> Any:
    """Return an integer that kernels give to kernels: for each plain one that it sees in a call
    numba compiles the kernel once more."""
    return np.int64(value)


@contextmanager
def when_compiling(tell: Callable[[], None]) -> Iterator[None]:
    """Call `tell` when numba begins to compile, once; not when it loads what it has kept."""

    class Listener(event.Listener):
        told = False

        def on_start(self, event: Any) -> None:
            if not self.told:
                self.told = True
                tell()

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield


def _stamp(locator: Any) -> Any:
    package = _outermost(Path(locator._py_file).parent)
    return _digest(package) if package.name.startswith("plate_") else _numbas_stamp(locator)


def _outermost(folder: Path) -> Path:
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


@cache
def _digest(package: Path) -> bytes:
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        if path.name != "node.py":
            digest.update(path.read_bytes())
    return digest.digest()


# What numba keeps beside compiled code; where it differs, the code is compiled anew.
_numbas_stamp = caching._SourceFileBackedLocatorMixin.get_source_stamp
caching._SourceFileBackedLocatorMixin.get_source_stamp = _stamp  # type: ignore[method-assign]
