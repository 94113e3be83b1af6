"""The compiled kernels; `kernels.cpp` of each chapter says what is in them."""

from typing import Any

import numpy as np

class Device:
    """A motor controller: the firmware, on a board in memory.

    Parameters
    ----------
    limits : DeviceLimits
    boot : int
        Another number after each reset.
    now_us : int
        Its clock [us].

    Attributes
    ----------
    triggered : bool
        Whether the camera's line is high.
    now_us, heard_us, enabled_us : int
        Time of the last tick, of the host's last frame, and when current was switched on last [us].
    state, faults, stops : int
        As in Telemetry.
    refused : int
        Damaged frames, modulo 65536.
    searches : bool
        Whether home is being searched for.
    room : int
        Bytes that a board can take; more would be lost.
    hottest : float
        Heat of the hottest motor, over what it bears.
    playing, waiting : int
        Number of the table or stream that plays, and that is taken over next; 0: none.
    play : (int, int, int) or None
        Buffer of the table that plays, times it was played before, time into it [TICK_S]; None: no
        table plays.
    """

    boot: int
    triggered: bool
    now_us: int
    heard_us: int
    enabled_us: int
    state: int
    faults: int
    stops: int
    refused: int
    searches: bool
    room: int
    hottest: float
    playing: int
    waiting: int
    play: tuple[int, int, int] | None

    def __init__(self, limits: Any, boot: int, now_us: int = 0) -> None: ...
    def tick(
        self,
        now_us: int,
        measured: np.ndarray,
        data: bytes,
        faults: int = 0,
        home_found: bool = True,
        line_idle: bool = True,
    ) -> tuple[bytes, np.ndarray | None]:
        """Let a tick pass; returns what is sent, and the setpoint, or None while current is off.

        Parameters
        ----------
        now_us : int
            Its clock [us].
        measured : (2, 4)
            Position [m] and acceleration [m/s2] of the motors, float32.
        data : bytes
            That have come.
        faults : int
            Of the board, now: SUPPLY, HARDWARE.
        home_found : bool
            Whether the search for home ends, if there is one.
        line_idle : bool
            Whether all that was sent has left.

        Returns
        -------
        bytes, and (3, 4) or None
            Position [m], speed [m/s] and acceleration [m/s2] of the motors, float32.
        """

    def sleep(self, now_us: int) -> None:
        """Let time pass in which it is not running yet [us]."""

    def table(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Return the times (k + 1,) [TICK_S] and states (k + 1, 3, 4) [m], [m/s], [m/s2] of the
        knots that play, or did last, and the time of the splice [TICK_S]; 0: none."""

def __getattr__(name: str) -> Any: ...
