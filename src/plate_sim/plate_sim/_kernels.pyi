"""Compiled kernels. `kernels.cpp` of each subpackage implements them."""

from typing import Any

import numpy as np

class Device:
    """Motor controller: the firmware on a simulated board.

    Parameters
    ----------
    limits : DeviceLimits
    boot : int
        Number that changes at each reset.
    now_us : int
        Device time [us].

    Attributes
    ----------
    triggered : bool
        Whether the camera's trigger line is high.
    now_us, received_us, enabled_us : int
        Time of the last tick, time of the last frame from the host, and time at which the current
        was last switched on [us].
    state, faults, stops : int
        Value of the field in Telemetry.
    refused : int
        Number of damaged frames, modulo 65536.
    searches : bool
        Whether a search for home is in progress.
    room : int
        Number of bytes that the board can receive. Further bytes would be lost.
    hottest : float
        Thermal load of the hottest motor, relative to the allowed load.
    playing, waiting : int
        Number of the table or stream that is being played, and of the one that follows. 0 means
        none.
    play : (int, int, int) or None
        Buffer of the table that is being played, number of completed plays, and time since the
        start of this play [TICK_S]. None if no table is being played.
    """

    boot: int
    triggered: bool
    now_us: int
    received_us: int
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
        """Simulate one tick. Return the sent bytes and the setpoint. The setpoint is None while the
        current is off.

        Parameters
        ----------
        now_us : int
            Time of the board's clock [us].
        measured : (2, 4)
            Position [m] and acceleration [m/s2] of the motors, float32.
        data : bytes
            Received bytes.
        faults : int
            Current faults of the board: SUPPLY, HARDWARE.
        home_found : bool
            Whether the search for home ends in this tick.
        line_idle : bool
            Whether all sent bytes have left the board.

        Returns
        -------
        bytes, and (3, 4) or None
            Position [m], speed [m/s] and acceleration [m/s2] of the motors, float32.
        """

    def sleep(self, now_us: int) -> None:
        """Advance the clock to `now_us` [us] before the firmware runs."""

    def table(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Return the times (k + 1,) [TICK_S] and states (k + 1, 3, 4) [m], [m/s], [m/s2] of the
        knots of the table that is being played or was played last, and the time of the splice
        [TICK_S]. The time is 0 if there is no splice."""

def __getattr__(name: str) -> Any: ...
