"""Record of the problems that the transport reports. The record determines which problems are
logged. The record also shows when the motors no longer play sent cycles."""

from __future__ import annotations

__all__ = ["TransportProblems"]

UNPLAYED_S = 0.5
"""Maximum time without a playing table after a table has failed [s]. After a longer time, a problem
is reported."""


class TransportProblems:
    """Record of the problems that the transport has reported. Times are on the steady clock.

    Parameters
    ----------
    repeat_s : float
        Minimum time between two log lines about the same problem [s].
    """

    def __init__(self, repeat_s: float) -> None:
        self._repeat_s = repeat_s
        self._logged: dict[str, float] = {}  # time of the last log of each problem [s]
        # Start [s] of the period in which no table was played, and the reason.
        self._unplayed: tuple[float, str] | None = None

    def new(self, problems: list[str], motors_rest: bool, now: float) -> list[str]:
        """Record problems at `now` [s], and return the problems that must be logged.

        `motors_rest` states whether the motors played no table at the last measurement.
        """
        self._logged = {
            p: logged_at
            for p, logged_at in self._logged.items()
            if logged_at > now - self._repeat_s
        }
        if problems and motors_rest and self._unplayed is None:
            self._unplayed = now, problems[0]
        new = [problem for problem in dict.fromkeys(problems) if problem not in self._logged]
        self._logged |= dict.fromkeys(new, now)
        return new

    def clear_unplayed(self) -> None:
        """Record that a table plays, or that no table needs to play."""
        self._unplayed = None

    def unplayed(self, now: float) -> str:
        """Return a message if sent cycles have not been played for a long time, otherwise an empty
        text."""
        if self._unplayed is None:
            return ""
        since, reason = self._unplayed
        if now - since <= UNPLAYED_S:
            return ""
        return f"no plate_cycle has been played for {now - since:.1f} s: {reason}"
