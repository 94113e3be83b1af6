"""Estimated offset between the host clock and the device clock, and check of the device clock. The
inputs are pulses and telemetry with their times. The outputs are the offset and clock faults.

For a pulse, the device reads its clock after the host has sent the heartbeat and before the pulse
arrives. For telemetry, the device reads its clock before the telemetry arrives. Therefore the times
of a message are bounds of the offset, which is host time minus device time. The distance between
the bounds grows with time, at the rate `DRIFT`. If the bounds cross, the device clock is wrong,
because delays on the line cannot cause this. The module reads no clock: all times are arguments.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from plate_core.serial_protocol import Pulse

__all__ = ["DRIFT", "DeviceClock"]

DRIFT = 2e-3
"""Maximum relative rate error between the device's and the host's clock [s/s]. A quartz is accurate
to 1e-4, and the operating system may slew the host's clock by 5e-4. With a larger error, a motion
could exceed its limits by more than the fraction 2e-3."""

TICK_S = 1e-3
"""Period of the device's tick [s]. The device time in a message can be rounded down to the last
tick."""

REJECTED_S = 2.0
"""Time for which a clock is rejected after an error [s]."""

STRIKES = 5
"""Number of errors within `REJECTED_S` plus 20 round trips after which the clock counts as broken.
A clock that runs too fast or backwards causes repeated errors. A clock that was set once causes
only one error. A slow or stopped clock causes no error, because it cannot cause motion beyond a
limit. A simulated device without processor time also has a slow clock."""

PULSE_AGE_S = 5.0
"""Maximum age of the last pulse [s]. If the last pulse is older, the estimated offset is rejected,
because two correct clocks may differ by 20 ms after this time."""


@dataclass(frozen=True)
class DeviceClock:
    """Estimated offset between the host clock and the device clock.

    Attributes
    ----------
    earliest, latest : float
        Bounds of host time minus device time at the last message [s]. Infinite before the first
        pulse and after implausible telemetry.
    at, pulse_at : float
        Arrival times of the last message and of the last pulse [s].
    since : tuple of float
        Host time and device time at which the current bounds start [s].
    device_us : int
        Latest device time received, in any message [us].
    wrong_at : float
        Host time of the last clock error [s].
    problem : str
        Description of the last clock error.
    strikes : tuple of float
        Host times at which the device clock last ran too fast or backwards [s].
    """

    earliest: float = float("-inf")
    latest: float = float("inf")
    at: float = float("-inf")
    pulse_at: float = float("-inf")
    since: tuple[float, float] = (0.0, 0.0)
    device_us: int = 0
    wrong_at: float = float("-inf")
    problem: str = ""
    strikes: tuple[float, ...] = ()

    @property
    def known(self) -> bool:
        """Whether a pulse has arrived, so that the offset is known."""
        return self.earliest > float("-inf")

    @property
    def offset_s(self) -> float:
        """Host time minus device time [s]. The error is at most half the shortest round-trip time.
        0 if the offset is not known."""
        return (self.earliest + self.latest) / 2 if self.known else 0.0

    def host_time(self, device_us: int) -> float:
        """Convert a device time [us] to host time [s]."""
        return device_us * 1e-6 + self.offset_s

    def after_pulse(self, pulse: Pulse, now: float) -> DeviceClock:
        """Return the clock after a pulse that arrived at `now` [s]."""
        sent, device = pulse.host_ns * 1e-9, pulse.device_us * 1e-6
        if sent > now:
            return self
        drift = DRIFT * (now - sent)
        clock = self._narrow_offset(
            sent - device - drift, now - device + drift, pulse.device_us, now
        )
        return replace(clock, pulse_at=now)

    def after_telemetry(self, device_us: int, now: float) -> DeviceClock:
        """Return the clock after telemetry with device time `device_us` that arrived at `now`
        [s]."""
        return self._narrow_offset(float("-inf"), now - device_us * 1e-6, device_us, now)

    def _narrow_offset(
        self, earliest: float, latest: float, device_us: int, now: float
    ) -> DeviceClock:
        """Return the clock after a message that shows that the offset is between `earliest` and
        `latest` [s]."""
        device_s, back = device_us * 1e-6, self.device_us - device_us
        restarted = replace(
            self,
            earliest=earliest,
            latest=latest,
            at=now,
            since=(now, device_s),
            device_us=device_us,
        )
        if back > 0:  # messages arrive in order, so a step backwards is an error
            return restarted._add_problem(f"went back by {1e-6 * back:.3f} s", now, strikes=True)
        if not self.known:
            return restarted
        drift = DRIFT * (now - self.at)
        fast = latest < self.earliest - drift
        earliest, latest = max(self.earliest - drift, earliest), min(self.latest + drift, latest)
        if earliest > latest + TICK_S:
            ran, passed = device_s - self.since[1], now - self.since[0]
            return restarted._add_problem(f"ran {ran:.3f} s in {passed:.3f} s", now, strikes=fast)
        # due to rounding, `earliest` may exceed `latest` by up to a tick
        middle = (earliest + latest) / 2
        bounds = min(earliest, middle), max(latest, middle)
        return replace(restarted, earliest=bounds[0], latest=bounds[1], since=self.since)

    def _add_problem(self, problem: str, now: float, strikes: bool) -> DeviceClock:
        new = (*self.strikes, now)[-STRIKES:] if strikes else self.strikes
        return replace(self, wrong_at=now, problem=f"the device's clock {problem}", strikes=new)

    def suspect(self, now: float) -> bool:
        """Return whether an error occurred within the last `REJECTED_S`."""
        return now - self.wrong_at < REJECTED_S

    def rejection(self, now: float) -> str:
        """Return the reason why device times are rejected at `now` [s]. Return "" if device times
        are accepted. The times of a slow clock are accepted, because each pulse that reveals the
        error also provides the correct offset.
        """
        if self.strikes and now - self.strikes[-1] < REJECTED_S:
            return self.problem
        if now - self.pulse_at > PULSE_AGE_S:
            return f"the device has not reported its clock for {now - self.pulse_at:.0f} s"
        return ""

    def broken(self, now: float, round_s: float) -> bool:
        """Return whether the clock is broken, for a line with the round trip `round_s` [s]."""
        window_s = REJECTED_S + 20 * round_s
        return len(self.strikes) == STRIKES and now - self.strikes[0] < window_s
