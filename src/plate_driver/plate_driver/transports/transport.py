"""Interface `Transport` between the driver node and the hardware that moves the plate.

Another package can add a transport. The package defines a class with the methods of `Transport`,
and a function that returns an instance for a `TransportContext`. The setup.py of the package names
the function:

    entry_points={"plate_driver.transports": ["ethercat = my_package.plate:make"]}

The driver then accepts `transport:=ethercat`. `make` raises a PlateError if a parameter is invalid.
The message is one line with the parameter, its value and the allowed values. `open` raises a
PlateError if any other requirement is not met.

All methods return immediately. The driver calls them from several threads, but never two methods at
the same time. It calls `poll` every few milliseconds. Times are on `TransportContext.clock`, so
that a test can replace the clock.
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


class Condition(Enum):
    """State of the motors."""

    GONE = "gone"  # the motor controller does not answer, so its state is unknown
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
        Reason why the motors are off or brake, or why their controller does not answer. A requested
        stop is EARLIER_STOP, because only the driver knows whether it requested the stop itself.
        OTHER is used for all reasons without a separate value.
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
        Number of the table that plays. 0 if no table plays.
    position, acceleration : tuple of 4 float
        Travel [m] and acceleration [m/s2] of each motor.
    playing : MotorTable or None
        Table that plays. If the tail of a table plays, this is the tail. None if unknown.
    began : float
        Time at which this table or tail started, on the context's clock [s].
    clock_problem : str
        Reason why `time` and `began` are rejected. Empty if they are accepted.
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
    longest_s : float
        Maximum time until the motor controller answers [s].
    """

    def __init__(self, longest_s: float = 0.0) -> None:
        self.longest_s = longest_s
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
        """Mark the order as done. If `failure` is not empty, mark it as failed. Later calls have no
        effect."""
        if not self.completed:
            self.failure = failure
            self._completed.set()
        return self

    def wait(self, longest_s: float | None = None) -> bool:
        """Wait until the order is complete (done or failed), and return whether it is done.

        The method waits at most `longest_s` [s]. None selects the value from the constructor.
        """
        self._completed.wait(self.longest_s if longest_s is None else max(0.0, longest_s))
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
        Maximum time for which a table is repeated [s].
    """

    motors: bool
    calibrates: bool

    @property
    def max_knots(self) -> int: ...

    @property
    def hold_s(self) -> float: ...

    def open(self) -> None:
        """Prepare the transport for calls of the other methods, without any motion.

        If this method raises a PlateError, the driver's configuration fails. A resource that may
        become available later, such as a port, must not raise an error. `poll` waits for it. Until
        it is available, the report is GONE and names the resource.
        """

    def poll(self) -> list[Measured]:
        """Perform due work, and return the measurements since the last call."""

    def report(self) -> Report:
        """Return the state of the motors."""

    def send(self, table: MotorTable, repeats: int) -> None:
        """Send a table. Every table ends at rest at home. It begins at rest at home, or at the
        splice of another table.

        When the current play ends, the motors start the newest table. They play it `repeats` times
        if no other table arrives, and then rest. A table with a tail is played once. At its splice,
        the motors continue with the newest table if this table begins at this splice, otherwise
        with the tail.

        Raises
        ------
        CycleError
            If the motors do not accept a table now, or refuse this table. The message states the
            reason.
        """

    def stop(self, cut: bool = False) -> Order:
        """Make the motors brake along their path, go home and switch off. If `cut` is True, switch
        them off immediately instead.

        The order is done when the controller has confirmed it. Earlier tables and orders are
        dropped.
        """

    def enable(self) -> Order:
        """Switch on the motors' current once, on a person's request. The order is done when the
        motors are ready.

        A stop after this request has priority. No other method or event is allowed to switch on the
        current, such as `open`, `send` or a restart of the controller.
        """

    def home(self) -> Order:
        """Make the motors search for home at the next enable. Calls are allowed only while the
        motors are off."""

    def troubles(self) -> list[str]:
        """Return the problems since the last call, one line each."""

    def values(self) -> dict[str, str]:
        """Return diagnostic values since the last call, by name."""

    def close(self) -> None:
        """Stop the motors and release all resources."""


@dataclass(frozen=True)
class TransportContext:
    """Inputs of a transport's constructor.

    Attributes
    ----------
    rig : Rig
    publish : callable
        Publishes a table on motor_setpoints.
    clock : callable
        Returns the monotonic time [s].
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
    """Return the installed transports by name. The search is made only once, because it takes 0.05
    s."""
    return {point.name: point for point in entry_points(group=GROUP)}


def make_transport(name: str, context: TransportContext) -> Transport:
    """Return the transport with the given name.

    Raises
    ------
    PlateError
        If the transport is not installed, cannot be loaded, or refuses a parameter.
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
    """Refuse a transport that is not installed, or lacks its port."""
    _check_name(name, installed())
    if name == "serial" and not port:
        raise PlateError("port is '', but transport serial requires the name of a serial port")


def _check_name(name: str, known: Iterable[str]) -> None:
    if name not in known:
        hint = did_you_mean(name, known)
        raise PlateError(f"transport is {name!r}{hint}, allowed: {', '.join(sorted(known))}")
