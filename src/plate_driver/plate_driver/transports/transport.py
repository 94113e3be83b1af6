"""Interface `Transport` between the driver node and the hardware that moves the plate.

Another package can add a transport. The package defines a class with the methods of `Transport`.
The package also defines a function that receives a `TransportContext` and returns an instance of
its transport class. The setup.py of the package names the function:

    entry_points={"plate_driver.transports": ["ethercat = my_package.plate:make"]}

The driver then accepts `transport:=ethercat`. The function raises a PlateError if a parameter is
invalid. The message of the error is one line with the parameter, its value and the allowed values.
The method `open` raises a PlateError if any other requirement is not met.

All methods return immediately. The driver calls the methods of a transport from several threads,
but never two methods at the same time. The driver calls `poll` every few milliseconds. All times
are read from `TransportContext.clock`, so that a test can replace the clock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol

from plate_core import PlateError, Rig, did_you_mean
from plate_core.driver_status import DriverReason

from ..setpoints import MotorTable

GROUP = "plate_driver.transports"
"""Entry-point group of transports."""

CALL_AGAIN = "; call again"
"""End of a reply that refuses enable or home only for the moment, because the device is not
connected yet or the driver was stalled. A program may repeat the call."""

STOPPED_SINCE = "another stop has arrived since then; call enable again"
"""Reply to a call of enable before the last stop. It does not end with `CALL_AGAIN`: a program must
not repeat the call, because only a person may clear a stop."""

UNCONNECTED = (DriverReason.NO_ANSWER, DriverReason.PORT)
"""Reasons in the report while the transport waits for the device."""


class Condition(Enum):
    """State of the motors."""

    GONE = "gone"  # the motor controller does not reply, so the state of the motors is unknown
    OFF = "off"  # the motors have no current
    ENABLING = "enabling"  # the plate moves home
    READY = "ready"  # the motors hold the plate at home or play a table, and accept a table
    BRAKING = "braking"


@dataclass(frozen=True)
class Report:
    """State of the motors as reported by their controller, not as commanded.

    Attributes
    ----------
    condition : Condition
    reason : DriverReason
        Reason why the motors are off or brake, or why their controller does not answer. The reason
        of every requested stop is EARLIER_STOP, because only the driver knows whether the driver
        itself requested the stop. OTHER represents all reasons that have no separate value.
    text : str
        The reason as text.
    values : mapping of str to str
        Values for the diagnostics.
    """

    condition: Condition
    reason: DriverReason = DriverReason.NONE
    text: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Measured:
    """Measurement of the motors' sensors.

    Attributes
    ----------
    time : float
        Time of the measurement on the context's clock [s].
    device_s : float
        The same time on the device's clock [s], without the jitter of the clock conversion.
    table : int
        Number of the motor table that plays. 0 if no table plays.
    position, acceleration : tuple of 4 float
        Travel [m] and acceleration [m/s2] of each motor.
    playing : MotorTable or None
        Motor table that plays. If the tail of a table plays, the tail itself. None if the table is
        unknown.
    began : float
        Time at which this table or tail started, on the context's clock [s].
    clock_problem : str
        Reason why `time` and `began` are unreliable. Empty if both times are reliable.
    """

    time: float
    device_s: float
    table: int
    position: tuple[float, ...]
    acceleration: tuple[float, ...]
    playing: MotorTable | None = None
    began: float = float("nan")
    clock_problem: str = ""


class Order:
    """A requested stop, enable or home, and its result.

    Parameters
    ----------
    max_s : float
        Maximum time until the motor controller confirms or refuses the order [s].
    """

    def __init__(self, max_s: float = 0.0) -> None:
        self.max_s = max_s
        self.failure = ""
        self._completed = threading.Event()

    @property
    def completed(self) -> bool:
        """Whether the order has succeeded or failed."""
        return self._completed.is_set()

    @property
    def done(self) -> bool:
        """Whether the motor controller has confirmed the order."""
        return self.completed and not self.failure

    def complete(self, failure: str = "") -> Order:
        """Mark the order as done. If `failure` is not empty, mark the order as failed. Only the
        first call of this method has an effect."""
        if not self.completed:
            self.failure = failure
            self._completed.set()
        return self

    def wait(self, max_s: float | None = None) -> bool:
        """Wait until the order is complete (done or failed), and return whether it is done.

        The method waits at most `max_s` [s]. If `max_s` is None, the method uses the value
        from the constructor.
        """
        self._completed.wait(self.max_s if max_s is None else max(0.0, max_s))
        return self.done


class Transport(Protocol):
    """Interface to the motors.

    Attributes
    ----------
    motors : bool
        Whether there are motors that need an enable. If False, `send` only publishes setpoints, and
        no enable is needed.
    calibrates : bool
        Whether the measurements of this transport can be used for a calibration.
    max_knots : int
        Maximum number of knots of a table.
    hold_s : float
        Maximum time for which the motors repeat a table if no other table arrives [s].
    """

    motors: bool
    calibrates: bool

    @property
    def max_knots(self) -> int: ...

    @property
    def hold_s(self) -> float: ...

    def open(self) -> None:
        """Prepare the transport for calls of the other methods. The method `open` must not move the
        motors.

        If this method raises a PlateError, the configuration of the driver node fails. If a
        resource may become available later, such as a port, its absence must not raise an error.
        The method `poll` then tries to open the resource. Until the resource is available, `report`
        returns the condition GONE and a text that names the resource.
        """

    def poll(self) -> list[Measured]:
        """Perform all work that is due, and return the measurements since the last call of
        `poll`."""

    def report(self) -> Report:
        """Return the state of the motors."""

    def send(self, table: MotorTable, repeats: int) -> None:
        """Send a motor table. Every table ends with the plate at rest at home. A table begins with
        the plate at rest at home, or at the splice of another table.

        When the current cycle ends, the motors start the newest table. If no other table arrives,
        the motors play the table `repeats` times and then rest. A table with a tail is played once.
        At the splice of this table, the motors continue with the newest table if the newest table
        begins at this splice. Otherwise, they continue with the tail.

        Raises
        ------
        CycleError
            If the motors do not accept a table at present, or refuse this table. The message of the
            error states the reason.
        """

    def stop(self, cut: bool = False) -> Order:
        """Make the motors brake along their path, return to home and switch off. If `cut` is True,
        switch off the motors immediately instead.

        The returned order is done when the motor controller has confirmed the stop. Earlier tables
        and orders are dropped.
        """

    def enable(self) -> Order:
        """Switch on the motors' current once, on a person's request. The returned order is done
        when the motors are ready.

        A stop after this request has priority. No other method or event may switch on the current.
        For example, `open`, `send` or a restart of the controller must not switch it on.
        """

    def home(self) -> Order:
        """Make the motors search for home at the next enable. The method `home` may be called only
        while the motors are off."""

    def troubles(self) -> list[str]:
        """Return the problems since the last call of this method, one line of text each."""

    def values(self) -> dict[str, str]:
        """Return values for the diagnostics, by name. Maxima and minima are those since the last
        call of this method."""

    def close(self) -> None:
        """Stop the motors and release all resources."""


@dataclass(frozen=True)
class TransportContext:
    """Inputs of a transport's constructor.

    Attributes
    ----------
    rig : Rig
    publish : callable
        Function that publishes a motor table on the topic motor_setpoints.
    clock : callable
        Function that returns the monotonic time [s].
    parameters : mapping of str to value
        All parameters of the driver, such as `port` and `baud`.
    seed : int
        Number that differs between processes.
    """

    rig: Rig
    publish: Callable[[MotorTable], None]
    clock: Callable[[], float]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0


@cache
def installed() -> dict[str, EntryPoint]:
    """Return the installed transports by name. The installed packages are searched only once,
    because a search takes 0.05 s."""
    return {point.name: point for point in entry_points(group=GROUP)}


def make_transport(name: str, context: TransportContext) -> Transport:
    """Return the transport with the given name.

    Raises
    ------
    PlateError
        If the transport is not installed, it cannot be loaded, or it refuses a parameter.
    """
    known = installed()
    _check_name(name, known)
    try:
        make = known[name].load()
    except (ImportError, AttributeError) as error:
        raise PlateError(
            f"transport is {name!r}, but its entry point {known[name].value} cannot be loaded: "
            f"{error}"
        ) from None
    made: Transport = make(context)
    return made


def check_transport(name: str, port: str) -> None:
    """Raise a PlateError if the transport is not installed, or if it requires a port and `port` is
    empty."""
    _check_name(name, installed())
    if name == "serial" and not port:
        raise PlateError("port is '', but transport serial requires the name of a serial port")


def _check_name(name: str, known: Iterable[str]) -> None:
    if name not in known:
        hint = did_you_mean(name, known)
        raise PlateError(f"transport is {name!r}{hint}, allowed: {', '.join(sorted(known))}")
