"""The user's cache of compiled files. All clones of the project share it.

    python cache.py take|keep PACKAGE BUILT ROOT

The key of an entry is a digest of all inputs from which the entry was made. A damaged entry is
ignored. If the folder cannot be written, no entries are stored.

The command line restores (`take`) or stores (`keep`) the folder BUILT, a package of messages that
was built from the folder PACKAGE. PACKAGE and BUILT are below the folder ROOT of the clone. An
entry may come from another clone; the path of this clone is then replaced by ROOT. The exit code is
not 0 if there is no matching entry.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
from contextlib import suppress
from pathlib import Path

MAX_BYTES = 100_000_000
"""Maximum total size of all entries in the cache [bytes]. If the size is exceeded, the least
recently used entries are removed."""

ROOT = b"@the root of the clone@"
"""Text that replaces the clone's path in stored packages."""

TOOLS = ("ros_", "catkin", "cmake", "empy", "lark", "numpy")
"""Name prefixes of the Python packages on which a built package of messages depends."""


def of_user() -> Path:
    """Return the cache folder of the current user."""
    place = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(place if os.path.isabs(place) else os.devnull, "vibrating-plate/compiled")


def key_of(*made_of: str | bytes) -> str:
    """Return the key of a cache entry that is made from the contents `made_of`."""
    digest = hashlib.sha256()
    for part in made_of:
        content = part.encode() if isinstance(part, str) else part
        digest.update(b"%d " % len(content) + content)
    return digest.hexdigest()


def take(folder: Path, key: str) -> bytes | None:
    """Return the content of a cache entry, or None if the entry is missing or damaged."""
    with suppress(OSError):
        data = (folder / key).read_bytes() if (folder / key).is_file() else b""
        if hashlib.sha256(data[32:]).digest() == data[:32]:
            with suppress(OSError):
                os.utime(folder / key)
            return data[32:]
    return None


def keep(folder: Path, key: str, content: bytes) -> None:
    """Write an entry atomically."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        part = folder / f"{key}-{os.getpid()}"
        try:
            part.write_bytes(hashlib.sha256(content).digest() + content)
            part.replace(folder / key)
        finally:
            part.unlink(missing_ok=True)
        left = MAX_BYTES
        for entry in sorted(folder.iterdir(), key=lambda e: e.stat().st_mtime, reverse=True):
            left -= entry.stat().st_size
            if left < 0:
                entry.unlink()


def compiler(command_line: list[str]) -> bytes:
    """Return a text that identifies a C++ compiler by its version, its target, and its search path
    of headers."""
    command = [*command_line, "-v", "-E", "-x", "c++", os.devnull]
    try:
        return subprocess.run(command, capture_output=True, check=False).stderr
    except FileNotFoundError:  # the compilation will report this error
        return b""


def _key_of_messages(package: Path, root: str) -> str:
    files = [path for path in sorted(package.rglob("*")) if path.is_file()]
    scripts = [path.read_bytes() for path in sorted(Path(root, "tools").glob("*.sh"))]
    # each RECORD file contains the digests of an installed package's files
    records = Path(sysconfig.get_path("purelib")).glob("*.dist-info/RECORD")
    tools = [p for p in sorted(records) if p.parent.name.startswith(TOOLS)]
    env = [os.environ.get(name, "") for name in ("CFLAGS", "CXXFLAGS", "LDFLAGS")]
    compilers = [os.environ.get("CC", "cc"), os.environ.get("CXX", "c++")]
    return key_of(
        sys.base_prefix, sys.version, *env, Path(__file__).read_bytes(), *scripts,
        *[compiler(command.split()) for command in compilers],
        *[line for p in tools for line in p.read_text().splitlines() if "/bin/" not in line],
        *[part for p in files for part in (str(p.relative_to(package)), p.read_bytes())],
    )  # fmt: skip


def _moved(content: bytes, here: bytes, there: bytes) -> bytes:
    return content if b"\0" in content else content.replace(here, there)


def _is_clear(content: bytes, root: bytes) -> bool:
    """Whether all occurrences of the path in a text are complete paths. An occurrence inside a
    longer word is not a complete path."""
    meant = re.findall(rb"(?<![\w.+-])" + re.escape(root) + rb"(?![\w.+-])", content)
    return b"\0" in content or len(meant) == content.count(root)


def _packed(built: Path, root: str) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz", compresslevel=1) as archive:
        for path in [path for path in sorted(built.rglob("*")) if path.is_file()]:
            if not _is_clear(path.read_bytes(), os.fsencode(root)):
                raise PermissionError(f"{root} is also a part of other words in {path}")
            content = _moved(path.read_bytes(), os.fsencode(root), ROOT)
            info = tarfile.TarInfo(str(path.relative_to(built)))
            # keep the modification time, because compiled bytecode refers to it
            info.size, info.mtime = len(content), int(path.stat().st_mtime)
            archive.addfile(info, io.BytesIO(content))
    return packed.getvalue()


def _unpack(packed: bytes, built: Path, root: str) -> None:
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for info in archive:
            path, content = built / info.name, archive.extractfile(info)
            assert content is not None  # the archive contains only files
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(_moved(content.read(), ROOT, os.fsencode(root)))
            os.utime(path, (info.mtime, info.mtime))


def main(action: str, package: str, built: str, root: str) -> int:
    """Restore a built package from the cache, or store it in the cache. Return the exit code."""
    key = _key_of_messages(Path(package), root)
    if action == "keep":
        # if the path contains links, files may contain one of two different paths, so nothing is
        # stored
        if root == os.path.realpath(root):
            with suppress(PermissionError):
                keep(of_user(), key, _packed(Path(built), root))
        return 0
    if (packed := take(of_user(), key)) is None:
        return 1
    _unpack(packed, Path(built), root)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
