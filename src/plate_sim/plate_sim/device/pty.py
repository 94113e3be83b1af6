"""Pseudo-terminal that the driver uses as a serial port. A symbolic link gives the pseudo-terminal
a fixed name. The pseudo-terminal can be unplugged and plugged in again like a USB adapter."""

from __future__ import annotations

import contextlib
import hashlib
import os
import socket
import tty
from pathlib import Path

from plate_core import PlateError

READ_BYTES = 65_536


class PseudoTerminal:
    """Pseudo-terminal that can be unplugged and plugged in again.

    Parameters
    ----------
    link : path
        Name of the symbolic link that serves as the port. A link that an ended process has left is
        replaced.
    """

    def __init__(self, link: str | Path) -> None:
        self._link = Path(link)
        self._ends: tuple[int, int] | None = None
        self._claim: socket.socket | None = None

    @property
    def plugged(self) -> bool:
        """Whether the port exists."""
        return self._ends is not None

    def plug(self) -> None:
        """Create the port. Keep its name for this object until `close`.

        Raises
        ------
        PlateError
            If no symbolic link with this name can be created, or if another running device uses
            this name.
        """
        if self._ends is not None:
            return
        if self._link.exists() and not self._link.is_symlink():
            raise PlateError(f"link is {str(self._link)!r}, which is a file, allowed: a new name")
        self._claim_name()
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        draft = self._link.with_name(f"{self._link.name}.{os.getpid()}")
        try:
            draft.unlink(missing_ok=True)
            draft.symlink_to(os.ttyname(slave))
            draft.replace(self._link)
        except OSError as error:
            os.close(master)
            os.close(slave)
            raise PlateError(f"link is {str(self._link)!r}: {error}") from None
        # This process keeps both ends of the terminal open. Otherwise the terminal would close when
        # a host disconnects.
        self._ends = master, slave

    def _claim_name(self) -> None:
        """Claim the name of the port, unless this object has claimed it before. An abstract socket
        is the claim, because Linux removes it when the process ends, however it ends."""
        if self._claim is not None:
            return
        path = str(self._link.absolute().parent.resolve() / self._link.name)
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            claim.bind(f"\0plate_sim device {hashlib.sha256(path.encode()).hexdigest()}")
        except OSError:
            claim.close()
            raise PlateError(
                f"link is {str(self._link)!r}, which another simulated device uses, "
                "allowed: a name that no running device uses"
            ) from None
        self._claim = claim

    def close(self) -> None:
        """Remove the port, and release its name."""
        self.unplug()
        if self._claim is not None:
            self._claim.close()
            self._claim = None

    def unplug(self) -> None:
        """Remove the port. If a host has opened the port, it receives an error."""
        if self._ends is None:
            return
        with contextlib.suppress(OSError):
            self._link.unlink()
        for end in self._ends:
            os.close(end)
        self._ends = None

    def read(self) -> bytes:
        """Read the bytes that the host has written."""
        if self._ends is None:
            return b""
        try:
            return os.read(self._ends[0], READ_BYTES)
        except OSError:  # the host has sent no bytes
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the host. If the buffer is full, bytes are lost, as with a real serial
        interface (UART)."""
        if self._ends is None or not data:
            return
        with contextlib.suppress(OSError):
            os.write(self._ends[0], data)
