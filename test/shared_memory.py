"""Removal of DDS shared memory. A killed process leaves up to 16 MB until the next boot."""

from __future__ import annotations

import fcntl
import time
from contextlib import suppress
from pathlib import Path

FOLDER = Path("/dev/shm")
"""Folder in which Linux shows shared memory."""

AGE_S = 60.0
"""Minimum age of a segment that is removed [s]."""


def remove_leftovers() -> None:
    """Remove the segments whose owner has ended.

    Each segment has a lock file, which Fast DDS keeps locked until the participant ends. A lock
    file younger than `AGE_S` is possibly not locked yet.
    """
    for lock in FOLDER.glob(f"fastrtps_{16 * '[0-9a-f]'}_el"):
        # Opening or locking raises an error if the file is in use or belongs to another user.
        with suppress(OSError), lock.open("rb") as file:
            if time.time() - lock.stat().st_mtime < AGE_S:
                continue
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            lock.with_name(lock.name.removesuffix("_el")).unlink(missing_ok=True)
            lock.unlink()
