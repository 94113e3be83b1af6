"""The rules of the feeder, without ROS. The rules determine which part a robot gets, when the plate
rests, and when the hopper opens. The hopper is a container that drops new parts onto the plate.

A `Feeder` receives the statuses of the planner (`receive_status`) and the commands of the robots.
The caller must call `step` after each status, after each command, and about every 0.1 s. `step`
returns the actions that the caller must take. Times are arguments of the methods, measured by one
steady clock. Only the stamps of statuses (`FeedStatus.stamp`) are measured by the clock of the
camera. A loop without ROS uses the feeder like this::

    feeder = Feeder(task, rig)
    reply = feeder.get_part("robot", now=t)  # None: the reply comes with a later `step`
    output = feeder.step(t)
    # execute output.order and output.open_s, read output.replies; then, for each image:
    feeder.receive_status(status, t)
    output = feeder.step(t)

The rules:

- The planner gets parts ready (mode `FEED`) until no more parts are needed. When no more parts are
  needed, the planner stops the plate without an order. The feeder then orders the planner to keep
  the plate at rest (mode `REST`), so that the next robot need not wait. If a command of a robot
  already waits, the feeder orders the planner to stop the plate when one part is ready.
- The feeder offers a part to a robot only if the newest status contains the mode `REST` and reports
  the plate at rest. The feeder does not change the mode of an order until a status has confirmed
  this mode. Therefore, the feeder never mistakes a status of an earlier rest for a status of the
  present rest. The other fields of an order, its picks and `hidden`, change at once if the mode
  stays the same.
- When a client receives the reply with a part, this part is reserved for the client and the plate
  rests. The reservation ends with `part_taken`, or with the next accepted `get_part`,
  `prepare_part` or `purge` of the same client. The reservation also ends when its validity has
  expired. Only one part is reserved at a time, for one client. If another client sends `get_part`,
  `prepare_part` or `purge` during the reservation, this client gets the reply `BUSY`. Only the
  client of the reservation may report the part as taken. The feeder sends the part's id only to
  this client. If this client has disconnected, any client that knows the id may report the part.
- After a `stop`, the feeder refuses all commands that move the plate until a person calls `resume`.
- A part that was reserved is not offered again until a later image shows that the part is ready.
  The stamp of this image must exceed the newest stamp at the end of the reservation by at least
  `SEEN_AGAIN_S`. After `MAX_FAILURES` failed picks at one place, a part is not offered until it is
  at another place. The planner counts a part as ready even while the feeder does not offer it for
  one of these two reasons. Therefore, the feeder then requests one more part of the same class.
- If several parts are ready, the feeder offers the part with the fewest failed picks. Among parts
  with equal numbers of failed picks, the feeder offers the part nearest to the centre of its pick
  window.
- The hopper opens if fewer parts than `least` are on the plate. If a command waits for a class of
  which no part is on the plate, the hopper opens if fewer parts than `fill` are on the plate. The
  time for which the hopper stays open is computed so that about `fill` parts are on the plate
  afterwards. The hopper does not open if it counts as empty. It does not open while a part is
  reserved, while the plate is purged, or while messages of the planner are missing.
- The feeder counts the new parts `FALLEN_S` after the hopper has closed. The image for this count
  must be taken while no part is reserved, because during a reservation the robot may hide some
  parts. Until this count, the hopper does not open again and the plate does not count as purged.
  Parts near the place where parts fall (within `SPREADS` spreads) are not offered until then.
- The hopper closes when a purge begins and when the task ends. After `MAX_OPENINGS` openings
  without new parts, the hopper counts as empty. Each new command then permits one more opening.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass, replace
from enum import Enum

from plate_core import MAX_PARTS, PlateError, Rig, part_class
from plate_core.tasks import (
    MAX_OPEN_S,
    FeedMode,
    FeedOrder,
    FeedTask,
    Pick,
    as_picked,
    pick_problem,
)

from .codes import Code
from .interface import FeedStatus, Output, Quantity, ReadyPart, Reply, Reserved, State

LATE_S = 0.3
"""Maximum delay from an image to its status [s]. When a reservation ends, the newest image may be
older than the present time by this delay. A later image was certainly taken after the end of the
reservation if its stamp exceeds the newest stamp by this delay."""

SEEN_AGAIN_S = 1.0
"""Maximum time for which the detector reports a part after a robot has taken it [s]. The detector's
tracker still reports a missing part for some images. If a part is reported after this time, the
robot has not taken the part."""

STATUS_TIMEOUT_S = 1.0
"""Maximum time between two statuses of a running task [s]. Ten cycles of the plate last about this
time."""

START_S = 10.0
"""Maximum time from the command that starts the planner's task to the first status of this task
[s]."""

SETTLED = 2
"""Number of consecutive statuses with the plate at rest after which the plate counts as settled. A
part may have moved between the last image of the moving plate and the first image of the plate at
rest. Therefore, the first status at rest contains no ready parts. While a command waits, the feeder
does not order the plate to move again before the plate has settled."""

FALLEN_S = 1.0
"""Time after the hopper closes until all dropped parts are visible [s]."""

MAX_OPENINGS = 3
"""Number of consecutive openings without a new part after which the hopper counts as empty."""

MAX_FAILURES = 3
"""Number of failed picks of a part at one place after which the part is no longer offered to
robots."""

MOVED_M = 0.002
"""If a part is farther than this distance from the place of a failed pick, it counts as moved [m].
The distance is larger than the error of the camera."""

SPREADS = 2.0
"""Maximum horizontal distance of a falling part from the hopper's place, divided by the hopper's
`spread_m`."""

WAITS = "stopped until a person calls resume_feeding: "
"""Beginning of the reply to commands after a stop. The reason for the stop follows."""

MAX_S = 3600.0
"""Maximum `timeout_s` of a command [s]."""


class _Task(Enum):
    IDLE = 0
    REQUESTED = 1
    RUNNING = 2


@dataclass(frozen=True)
class _Request:
    """Part that a command requests: a class ("" for any class), and optionally a pick. The pick
    replaces the pick of this class in the recipe."""

    label: str = ""
    pick: Pick | None = None


@dataclass(frozen=True)
class _Waiting:
    """A command that waits for its reply."""

    client: Hashable
    request: _Request
    until: float
    timeout_s: float
    purge: bool = False


@dataclass(frozen=True)
class _Failures:
    """Number of failed picks of a part, and the place of these picks [m]."""

    count: int
    x: float
    y: float


class Feeder:
    """Gives parts to robots, one at a time. The docstring of this module describes the rules.

    Parameters
    ----------
    task : FeedTask
        Task of the recipe.
    rig : Rig

    Notes
    -----
    A `client` is any hashable value except None that identifies a client. The methods
    `prepare_part` and `part_taken` return a `Reply` at once. If `get_part` or `purge` is refused,
    it returns a `Reply` at once. If the command is accepted, the method returns None, and a later
    `step` returns the reply.
    """

    def __init__(self, task: FeedTask, rig: Rig) -> None:
        self.task, self._rig = task, rig
        self._status: FeedStatus | None = None
        self._ended = False  # whether the task was stopped or has failed
        self._stop = ""  # reason why no command starts before `resume`
        self._task, self._since = _Task.IDLE, -math.inf  # time of the last command or status
        self._sent, self._in_force = FeedOrder(FeedMode.FEED, task.picks), False
        self._rested = 0  # number of status messages since the plate rests because of an order
        # Whether the planner has stopped the plate without an order because enough parts are ready.
        self._planner_rested = False
        self._waiting: _Waiting | None = None
        self._prepared: _Request | None = None
        self._reserved: Reserved | None = None
        # reservation that has ended before the robot reported the pick
        self._late: Reserved | None = None
        # For each part id: stamp of the newest status at the end of the part's reservation.
        self._held: dict[str, float] = {}
        self._failures: dict[str, _Failures] = {}
        self._replies: list[tuple[Hashable, Reply]] = []
        # Numbers of taken, discharged and lost parts. The numbers of discharged and lost parts
        # include only earlier tasks.
        self._taken = self._discharged = self._lost = 0
        self._unreported = 0  # number of reservations that ended without a report of the pick
        # Total number of parts before the hopper was opened; None if no opening is pending.
        self._total_before_opening: int | None = None
        self._evaluate_at, self._vain_openings = -math.inf, 0

    # Inputs

    def receive_status(self, status: FeedStatus, now: float) -> None:
        """Process a new status of the planner, which arrived at the time `now` [s]."""
        self._status = status
        self._held = {
            part: since
            for part, since in self._held.items()
            # If the clock was set back by a long time, the part is offered again immediately.
            if -SEEN_AGAIN_S < status.stamp - since < SEEN_AGAIN_S
        }
        if self._task is _Task.IDLE:
            return
        self._task, self._since = _Task.RUNNING, now
        self._in_force |= status.mode is self._sent.mode
        self._rested = self._rested + 1 if self._is_resting() else 0
        self._planner_rested |= status.mode is FeedMode.FEED and status.at_rest

    def task_ended(self, text: str) -> None:
        """Record that the planner's task has ended or was refused. The caller may also call this
        method if the task must end. A waiting command then gets a reply with the text `text`."""
        self._reply_to_waiting(Code.STOPPED, text)
        self._end_task()
        self._ended = True

    def stop(self, why: str) -> None:
        """End the task. Until `resume` is called, refuse each command that would move the plate.
        Call this method if a person has stopped the plate, or if a person must check the plate.
        `why` is the reason as text."""
        self._stop = WAITS + why
        self.task_ended(self._stop)

    def resume(self) -> None:
        """Permit the next command to start the task again. Only a person may permit this."""
        if self._stop:
            self._stop, self._ended = "", False

    def get_part(
        self,
        client: Hashable,
        label: str = "",
        pick: Pick | None = None,
        timeout_s: float = 0.0,
        *,
        now: float,
    ) -> Reply | None:
        """Request a part for a robot. If the request is accepted, a later `step` returns the reply.
        A refusal is returned at once.

        Parameters
        ----------
        client : hashable
        label : str
            Class of the part. If `label` is empty, the class of `pick` is used. If there is no
            `pick` either, the request of the last `prepare_part` is used, or else any class of the
            recipe.
        pick : Pick, optional
            Window, angle or number that replaces the values of the recipe for this command.
        timeout_s : float
            Maximum time until the reply [s]. 0 selects the value of the recipe.
        now : float
            Present time [s].

        Returns
        -------
        Reply or None
            Refusal, or None if the request was accepted and waits for its reply.
        """
        request = self._read_request(label, pick, timeout_s)
        if isinstance(request, Reply):
            return request
        if refusal := self._refusal(client):
            return refusal
        if request == _Request() and self._prepared is not None:
            request = self._prepared
        self._prepared = None
        self._end_reservation()
        timeout_s = timeout_s or self.task.timeout_s
        self._waiting = _Waiting(client, request, now + timeout_s, timeout_s)
        self._begin_task(now)
        return None

    def prepare_part(
        self, client: Hashable, label: str = "", pick: Pick | None = None, *, now: float
    ) -> Reply:
        """Request that a part is made ready for the next `get_part` without a class. Any client may
        send this `get_part`. The request stays valid if the client that made it disconnects. The
        parameters are the same as in `get_part`."""
        request = self._read_request(label, pick)
        if isinstance(request, Reply):
            return request
        if refusal := self._refusal(client):
            return refusal
        self._end_reservation()
        self._prepared = request
        self._begin_task(now)
        return Reply(Code.DONE, f"{request.label or 'a part'} is being prepared")

    def part_taken(self, client: Hashable, part: str = "", taken: bool = True) -> Reply:
        """Record the report of a robot that has tried to take a part and is no longer above this
        part.

        Parameters
        ----------
        client : hashable
        part : str
            Id of the part. An empty text selects the part that is reserved for this client. If the
            client of the reservation has disconnected, the id must be given. If the reservation of
            a part has expired, the part may still be reported until the next part is reserved.
        taken : bool
            Whether the robot has the part. If False, the part is still on the plate.
        """
        known = self._reserved or self._late
        if known is None:
            return Reply(Code.NOT_RESERVED, "no part is reserved")
        if known.client != client and (known.client is not None or part != known.part.id):
            # The text is the same for all part ids, so that clients cannot guess the id of the
            # reserved part.
            text = "the part is reserved for another client, allowed: the part's id, if this "
            text += "client has disconnected"
            return Reply(Code.NOT_RESERVED, text)
        if part not in ("", known.part.id):
            return Reply(Code.NOT_RESERVED, f"{part} is not reserved, allowed: {known.part.id}")
        self._hold_back(known.part)
        late = ""
        if self._reserved is None:
            late = ", but its reservation had expired, so the plate may have moved"
            self._unreported -= 1
        self._reserved = self._late = None
        name = known.part.id
        if taken:
            self._taken += 1
            self._failures.pop(name, None)
            return Reply(Code.DONE, f"{name} is taken{late}")
        x, y = known.part.x, known.part.y
        before = self._failures.pop(name, _Failures(0, x, y))
        count = before.count + 1 if math.hypot(x - before.x, y - before.y) <= MOVED_M else 1
        self._failures[name] = _Failures(count, x, y)
        while len(self._failures) > MAX_PARTS:
            del self._failures[next(iter(self._failures))]
        text = f"{name} is still on the plate; number of failed picks at this place: {count}{late}"
        return Reply(Code.DONE, text)

    def purge(self, client: Hashable, timeout_s: float = 0.0, *, now: float) -> Reply | None:
        """Request that all parts are moved to the chute. When the plate is empty, the task ends.
        Return a refusal, or None if the request was accepted and waits for its reply. `timeout_s`
        and `now` are the same as in `get_part`."""
        problem = _time_problem(timeout_s)
        if problem:
            return Reply(Code.BAD_ARGUMENT, problem)
        left = self._status.total if self._status is not None else 0
        if self.task.chute is None:
            return Reply(Code.NOT_PURGED, "the recipe has no chute; purge needs one", left=left)
        if refusal := self._refusal(client):
            return replace(refusal, left=left)
        self._prepared = None
        self._end_reservation()
        timeout_s = timeout_s or self.task.timeout_s
        self._waiting = _Waiting(client, _Request(), now + timeout_s, timeout_s, purge=True)
        self._begin_task(now)
        return None

    def cancel(self, client: Hashable) -> None:
        """Withdraw the waiting command of a client. The command gets no reply. A reserved part
        remains reserved, because the robot may be above this part. If the withdrawn command is a
        purge, the task ends."""
        waiting = self._waiting
        if waiting is not None and waiting.client == client:
            self._waiting = None
            if waiting.purge:
                self._end_task()

    def remove_client(self, client: Hashable) -> None:
        """Remove a client that has disconnected, and withdraw the client's waiting command. A part
        that is reserved for this client remains reserved, but no longer for a client."""
        self.cancel(client)
        self._reserved, self._late = (
            replace(request, client=None)
            if request is not None and request.client == client
            else request
            for request in (self._reserved, self._late)
        )

    # Outputs

    def step(self, now: float) -> Output:
        """Return the actions that the caller must take at the time `now` [s]."""
        if self._reserved is not None and now >= self._reserved.until:
            self._end_reservation()
        if self._waiting is not None:
            self._answer_get_part(self._waiting, now)
        # without a status from the planner, end the request, so that the task does not start later
        if self._task is _Task.REQUESTED and self.no_status_text(now):
            self._end_task()
        open_s = self._opening_time(now)
        self._update_order()
        replies, self._replies = tuple(self._replies), []
        return Output(self._task is not _Task.IDLE, self._sent, open_s, replies)

    def quantity(self) -> Quantity:
        """Return how many parts are on the plate, are ready, and have left the plate, see
        `Quantity`."""
        status = self._status or FeedStatus(0.0, FeedMode.FEED, False)
        running = self._task is _Task.RUNNING
        return Quantity(
            seen=status.seen,
            ready=len(self._offered_parts(_Request())) if running else 0,
            taken=self._taken,
            discharged=self._discharged + running * status.discharged,
            lost=self._lost + running * status.lost,
        )

    def state(self, now: float) -> State:
        """Return the state of the feeder."""
        waiting = self._waiting
        if self._ended:
            return State.STOPPED
        if self._reserved is not None:
            return State.RESERVED
        if self._task is _Task.REQUESTED:
            return State.STARTING
        if self.no_status_text(now):
            return State.SILENT
        if waiting is not None:
            return State.PURGING if waiting.purge else State.WAITING
        if self._task is _Task.IDLE:
            return State.IDLE
        return State.FEEDING if self._sent.mode is FeedMode.FEED else State.READY

    @property
    def stopped(self) -> str:
        """Reason why commands are refused until `resume` is called, as text for a robot. The text
        is empty if the next command may start the task."""
        return self._stop

    @property
    def reserved(self) -> Reserved | None:
        """Part that is reserved for a client. None if no part is reserved."""
        return self._reserved

    @property
    def hopper_empty(self) -> bool:
        """Whether the last openings of the hopper brought no new parts."""
        return self._vain_openings >= MAX_OPENINGS

    def no_status_text(self, now: float) -> str:
        """Return a text that describes which messages of the planner are missing. The text is empty
        if no messages are missing."""
        age = now - self._since
        if self._task is _Task.REQUESTED and age > START_S:
            return f"the planner has not started feed_parts within {START_S:g} s"
        if self._task is _Task.RUNNING and age > STATUS_TIMEOUT_S:
            hint = "check that the planner runs and the computer is not too slow"
            return f"no feed_status for {age:.1f} s; {hint}"
        return ""

    # Commands

    def _read_request(
        self, label: str, pick: Pick | None, timeout_s: float = 0.0
    ) -> _Request | Reply:
        """Convert the arguments of a command to a request. If an argument is invalid, return a
        reply with the error instead."""
        labels = [allowed_pick.label for allowed_pick in self.task.picks]
        problem = _time_problem(timeout_s)
        if pick is not None:
            label, pick = label or pick.label, replace(pick, label=pick.label or label)
        if (label or pick is not None) and label not in labels:
            problem = f"class is {label!r}, allowed: {', '.join(labels)}"
        elif pick is not None and pick.label != label:
            problem = f"class is {label}, allowed: {pick.label} (the class of the pick)"
        elif pick is not None:
            try:
                problem = problem or pick_problem(pick, self._rig)
            except PlateError as error:
                problem = str(error)
        return Reply(Code.BAD_ARGUMENT, problem) if problem else _Request(label, pick)

    def _refusal(self, client: Hashable) -> Reply | None:
        """Return a refusal of a command that would move the plate, or None if the command is
        allowed."""
        if self._stop:
            return Reply(Code.STOPPED, self._stop)
        waiting, reserved = self._waiting, self._reserved
        if waiting is not None:
            text = "the plate is being purged" if waiting.purge else "another get_part is waiting"
            return Reply(Code.BUSY, text)
        if reserved is not None and reserved.client != client:
            return Reply(Code.BUSY, "another client has reserved a part")
        return None

    def _begin_task(self, now: float) -> None:
        self._vain_openings = min(self._vain_openings, MAX_OPENINGS - 1)
        if self._task is _Task.IDLE:
            # discard the old total, because the parts may have changed since the last opening
            if now >= self._evaluate_at:
                self._total_before_opening = None
            self._task, self._since, self._ended = _Task.REQUESTED, now, False
            self._sent, self._in_force = FeedOrder(FeedMode.FEED, self._picks()), False

    def _end_task(self) -> None:
        if self._task is _Task.RUNNING and self._status is not None:
            self._discharged += self._status.discharged
            self._lost += self._status.lost
        self._task, self._prepared = _Task.IDLE, None

    def _end_reservation(self) -> None:
        """End the reservation without a report about the pick. Later images show whether the part
        is still on the plate."""
        if self._reserved is not None:
            self._hold_back(self._reserved.part)
            self._late, self._reserved = self._reserved, None
            self._unreported += 1

    def _hold_back(self, part: ReadyPart) -> None:
        assert self._status is not None  # a part is known only from a status, so there is a status
        self._held[part.id] = self._status.stamp

    # Replies to waiting commands

    def _reply_to_waiting(
        self, code: Code, text: str, part: ReadyPart | None = None, until: float = math.nan
    ) -> None:
        waiting, self._waiting = self._waiting, None
        left = self._status.total if self._status is not None else 0
        if waiting is not None:
            reply = Reply(code, text, part, until, left if waiting.purge else 0)
            self._replies.append((waiting.client, reply))

    def _answer_get_part(self, waiting: _Waiting, now: float) -> None:
        text = self.no_status_text(now)
        if text:
            self._reply_to_waiting(Code.SILENT, text)
        elif waiting.purge:
            self._answer_purge(waiting, now)
        elif self._is_resting() and (offers := self._offered_parts(waiting.request)):
            part, until = self._select_part(offers), now + self.task.valid_s
            self._reply_to_waiting(Code.DONE, f"{part.id} is ready", part, until)
            self._reserved, self._late = Reserved(waiting.client, part, until), None
            self._planner_rested = False
        elif self.hopper_empty and not self._count_on_plate(waiting.request.label):
            self._reply_to_waiting(
                Code.HOPPER_EMPTY,
                f"no {waiting.request.label or 'part'} is on the plate, and no part came out of "
                f"the hopper in {MAX_OPENINGS} openings",
            )
        elif now >= waiting.until:
            quantity, label = self.quantity(), waiting.request.label
            self._reply_to_waiting(
                Code.NO_PART,
                f"no {label or 'part'} was ready within {waiting.timeout_s:g} s; parts on the "
                f"plate: {sum(quantity.seen.values())}, of them {label or 'in the recipe'}: "
                f"{self._count_on_plate(label)}; ready parts of any class: {quantity.ready}"
                + ("; the hopper is empty" if self.hopper_empty else "")
                + ("; the recipe has no hopper" if self.task.hopper is None else ""),
            )

    def _answer_purge(self, waiting: _Waiting, now: float) -> None:
        purging = self._in_force and self._sent.mode is FeedMode.PURGE
        left = self._status.total if self._status is not None else 0
        # `_total_before_opening` is None if no opening is pending. In this case, no more parts will
        # fall on the plate.
        if purging and not left and self._total_before_opening is None:
            self._reply_to_waiting(Code.DONE, "the plate is empty")
            self._end_task()
        elif now >= waiting.until:
            text = f"{left} parts are still on the plate after {waiting.timeout_s:g} s"
            self._reply_to_waiting(Code.NOT_PURGED, text)
            self._end_task()

    def _is_resting(self) -> bool:
        """Whether the plate was at rest in the newest status and stays at rest until the order
        changes."""
        status = self._status
        return (
            self._task is _Task.RUNNING
            and self._in_force
            and self._sent.mode is FeedMode.REST
            and status is not None
            and status.mode is FeedMode.REST
            and status.at_rest
        )

    # Parts

    def _picks(self) -> tuple[Pick, ...]:
        """Return the picks that the planner must get ready. For each ready part that must not be
        offered to robots, one more part of the same class is requested."""
        request = self._waiting.request if self._waiting is not None else self._prepared
        other = None if request is None else request.pick
        picks = [
            other if other is not None and other.label == pick.label else pick
            for pick in self.task.picks
        ]
        kept = {
            *self._held,
            *(part.id for part in self._ready_parts() if self._has_failed_often(part)),
        }
        labels = [part_class(name) for name in kept]
        return tuple(
            replace(pick, ready=min(pick.ready + labels.count(pick.label), MAX_PARTS))
            for pick in picks
        )

    def _is_image_complete(self) -> bool:
        """Whether the newest image shows all parts. During a reservation, a robot may hide some
        parts."""
        newest = -math.inf if self._status is None else self._status.stamp
        return self._reserved is None and all(
            newest >= since + LATE_S for since in self._held.values()
        )

    def _ready_parts(self) -> tuple[ReadyPart, ...]:
        return () if self._status is None else self._status.ready

    def _offered_parts(self, request: _Request) -> list[ReadyPart]:
        """Return the parts in the newest status that may be offered for the request `request`."""
        picks = {pick.label: pick for pick in self._picks()}
        return [
            part
            for part in self._ready_parts()
            if request.label in ("", part.label)
            and part.label in picks
            and as_picked(part.alone, picks[part.label], self._rig)[0]
            and part.id not in self._held
            and not self._has_failed_often(part)
            and not self._is_fallen_on(part)
        ]

    def _has_failed_often(self, part: ReadyPart) -> bool:
        failed = self._failures.get(part.id)
        return (
            failed is not None
            and failed.count >= MAX_FAILURES
            and math.hypot(part.x - failed.x, part.y - failed.y) <= MOVED_M
        )

    def _is_fallen_on(self, part: ReadyPart) -> bool:
        """Whether a part from the hopper may fall on the part `part`, or may have fallen on it
        after the newest image."""
        hopper = self.task.hopper
        if hopper is None or self._total_before_opening is None:
            return False
        x, y = hopper.place
        return math.hypot(part.x - x, part.y - y) <= SPREADS * hopper.spread_m

    def _select_part(self, offers: list[ReadyPart]) -> ReadyPart:
        picks = {pick.label: pick for pick in self._picks()}

        def rank(part: ReadyPart) -> tuple[int, float, str]:
            low, high = picks[part.label].low, picks[part.label].high
            middle = [
                (a + b) / 2 if math.isfinite(a + b) else 0.0 for a, b in zip(low, high, strict=True)
            ]
            failed = self._failures.get(part.id)
            distance = math.hypot(part.x - middle[0], part.y - middle[1])
            return (0 if failed is None else failed.count), distance, part.id

        return min(offers, key=rank)

    def _count_on_plate(self, label: str) -> int:
        seen = {} if self._status is None else self._status.seen
        labels = [label] if label else [pick.label for pick in self.task.picks]
        return sum(seen.get(class_name, 0) for class_name in labels)

    # Orders

    def _update_order(self) -> None:
        """Update the order to the planner. The mode of the order changes only after a status has
        confirmed the previous mode."""
        if self._task is not _Task.RUNNING:
            return
        order = FeedOrder(self._next_mode(), self._picks(), hidden=self._reserved is not None)
        if order.mode is self._sent.mode:
            self._sent = order
        elif self._in_force:
            self._sent, self._in_force = order, False

    def _next_mode(self) -> FeedMode:
        waiting = self._waiting
        if self._reserved is not None:
            return FeedMode.REST
        if waiting is not None and waiting.purge:
            return FeedMode.PURGE
        if waiting is not None:
            settling = self._sent.mode is FeedMode.REST and self._rested < SETTLED
            # If the plate is coming to rest, wait until it has settled.
            ready = settling or self._offered_parts(waiting.request)
            return FeedMode.REST if ready else FeedMode.FEED
        offers = [part.label for part in self._offered_parts(self._prepared or _Request())]
        counts = {pick.label: pick.ready for pick in self.task.picks}
        if self._prepared is not None and self._prepared.label:
            label, pick = self._prepared.label, self._prepared.pick
            counts = {label: counts[label] if pick is None else pick.ready}
        enough = all(offers.count(label) >= count for label, count in counts.items())
        self._planner_rested &= enough
        return FeedMode.REST if self._planner_rested else FeedMode.FEED

    # The hopper

    def _opening_time(self, now: float) -> float | None:
        """Return the value of `Output.open_s`: the time for which the hopper must be open from now
        on [s]."""
        hopper, status = self.task.hopper, self._status
        purging = self._waiting is not None and self._waiting.purge
        is_open = self._total_before_opening is not None and now < self._evaluate_at - FALLEN_S
        if is_open and (purging or self._task is _Task.IDLE):
            self._evaluate_at = now + FALLEN_S
            return 0.0
        if hopper is None or status is None or self._task is not _Task.RUNNING:
            return None
        total, quantity = status.total, self.quantity()
        total_parts = (
            total + quantity.taken + self._unreported + quantity.discharged + quantity.lost
        )
        if (
            self._total_before_opening is not None
            and now >= self._evaluate_at
            and self._is_image_complete()
        ):
            self._vain_openings = (
                0 if total_parts > self._total_before_opening else self._vain_openings + 1
            )
            self._total_before_opening = None
        if self._reserved is not None or purging or self.no_status_text(now):
            return None
        absent = self._waiting is not None and not self._count_on_plate(self._waiting.request.label)
        enough = hopper.fill if absent else hopper.least
        if self._total_before_opening is not None or self.hopper_empty or total >= enough:
            return None
        open_s = min((hopper.fill - total) / hopper.rate, MAX_OPEN_S)
        self._total_before_opening, self._evaluate_at = total_parts, now + open_s + FALLEN_S
        return open_s


def _time_problem(timeout_s: float) -> str:
    if 0 <= timeout_s <= MAX_S:
        return ""
    return f"timeout_s is {timeout_s:g}, allowed: 0 (value of the recipe) to {MAX_S:g}"
