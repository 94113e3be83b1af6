"""Where the device's clock stands on the host's, and whether it can be true. Pure; times are
arguments.

No wait on the way can make a true clock look wrong: the device reads its clock for a pulse after
the heartbeat was sent and before the pulse came, and for telemetry before that came. So host time
less device time lies between two bounds, which grow apart as fast as two true clocks may. Bounds
that cross are a proof.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from plate_core.serial_protocol import Pulse

__all__ = ["DRIFT", "DeviceClock"]

DRIFT = 2e-3
"""By how much the device's clock may run faster or slower than the host's: a quartz is right to
1e-4, the system may slew the host's by 5e-4, and limits of motion are kept to 2e-3, no better."""

TICK_S = 1e-3
"""A device may tell the time of its tick, not of the very instant [s]."""

DOUBT_S = 2.0
"""Time for which a clock that was wrong is not believed [s]."""

STRIKES = 5
"""Times that a clock runs too fast or back within `DOUBT_S` and twenty round trips, and it is no
clock. One that was set is wrong once; one that is slow, or stands still, passes no limit: so does a
simulated device without a processor."""

PULSE_AGE_S = 5.0
"""A clock that no pulse has told for so long is not believed [s]: true ones may be 20 ms apart."""


@dataclass(frozen=True)
class DeviceClock:
    """Where the device's clock stands on the host's.

    Attributes
    ----------
    earliest, latest : float
        Bounds of host time less device time, when the last message came [s]; infinite before the
        first pulse, and after telemetry that cannot be.
    at, pulse_at : float
        When the last message came, and the last pulse [s].
    since : tuple of float
        Host's and device's time when the bounds began [s].
    told_us : int
        Last time that the device told, whatever the message [us].
    wrong_at : float
        When it was wrong last [s].
    problem : str
        What was wrong then.
    strikes : tuple of float
        When it ran too fast or back, the last few times [s].
    """

    earliest: float = float("-inf")
    latest: float = float("inf")
    at: float = float("-inf")
    pulse_at: float = float("-inf")
    since: tuple[float, float] = (0.0, 0.0)
    told_us: int = 0
    wrong_at: float = float("-inf")
    problem: str = ""
    strikes: tuple[float, ...] = ()

    @property
    def known(self) -> bool:
        """Whether a pulse has told where it stands."""
        return self.earliest > float("-inf")

    @property
    def offset_s(self) -> float:
        """Host time less device time [s], right to half the shortest round trip; 0: not known."""
        return (self.earliest + self.latest) / 2 if self.known else 0.0

    def host_time(self, device_us: int) -> float:
        """Return the host's time [s] of a time of the device."""
        return device_us * 1e-6 + self.offset_s

    def heard(self, pulse: Pulse, now: float) -> DeviceClock:
        """Return the clock after a pulse that came at `now` [s]."""
        sent, device = pulse.host_ns * 1e-9, pulse.device_us * 1e-6
        if sent > now:
            return self
        drift = DRIFT * (now - sent)
        clock = self._bounded(sent - device - drift, now - device + drift, pulse.device_us, now)
        return replace(clock, pulse_at=now)

    def stamped(self, device_us: int, now: float) -> DeviceClock:
        """Return the clock after telemetry of a time of the device, which came at `now` [s]."""
        return self._bounded(float("-inf"), now - device_us * 1e-6, device_us, now)

    def _bounded(self, earliest: float, latest: float, device_us: int, now: float) -> DeviceClock:
        """Return the clock after a message that sets bounds."""
        own, back = device_us * 1e-6, self.told_us - device_us
        begun = replace(
            self, earliest=earliest, latest=latest, at=now, since=(now, own), told_us=device_us
        )
        if back > 0:  # whatever a device says, it says in order
            return begun._found(f"went back by {1e-6 * back:.3f} s", now, strikes=True)
        if not self.known:
            return begun
        drift = DRIFT * (now - self.at)
        fast = latest < self.earliest - drift
        earliest, latest = max(self.earliest - drift, earliest), min(self.latest + drift, latest)
        if earliest > latest + TICK_S:
            ran, passed = own - self.since[1], now - self.since[0]
            return begun._found(f"ran {ran:.3f} s in {passed:.3f} s", now, strikes=fast)
        middle = (earliest + latest) / 2  # they may cross by a tick
        bounds = min(earliest, middle), max(latest, middle)
        return replace(begun, earliest=bounds[0], latest=bounds[1], since=self.since)

    def _found(self, problem: str, now: float, strikes: bool) -> DeviceClock:
        new = (*self.strikes, now)[-STRIKES:] if strikes else self.strikes
        return replace(self, wrong_at=now, problem=f"the device's clock {problem}", strikes=new)

    def suspect(self, now: float) -> bool:
        """Tell whether it was wrong of late."""
        return now - self.wrong_at < DOUBT_S

    def doubt(self, now: float) -> str:
        """Say why times of the device are not believed at `now` [s]; empty if they are, as those of
        a slow clock: each pulse that shows it slow tells where it stands."""
        if self.strikes and now - self.strikes[-1] < DOUBT_S:
            return self.problem
        if now - self.pulse_at > PULSE_AGE_S:
            return f"the device's clock was not told for {now - self.pulse_at:.0f} s"
        return ""

    def broken(self, now: float, round_s: float) -> bool:
        """Tell whether it is no clock, over a line of this round trip [s]."""
        longest = DOUBT_S + 20 * round_s
        return len(self.strikes) == STRIKES and now - self.strikes[0] < longest
