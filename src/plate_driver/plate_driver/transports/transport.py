"""Where motor tables go: one interface, so that the node does not know what moves the plate.

Another package adds a transport without touching this one. It writes a class with the methods of
`Transport`, and a function that makes one of a `TransportContext`; its setup.py names the function:

    entry_points={"plate_driver.transports": ["ethercat = my_package.plate:make"]}

The driver then takes `transport:=ethercat`. `make` raises a PlateError if a parameter does not fit,
in one line that names the parameter, its value and what is allowed; `open` if something is missing.

All methods return at once. The driver calls them from several threads, but one at a time; `poll`
every few milliseconds. Times are of `TransportContext.clock`, so that a test can be the clock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol

from plate_core import PlateError, Rig, did_you_mean
from plate_core.driver_status import DriverReason

from ..setpoints import MotorTable

GROUP = "plate_driver.transports"
"""Entry points of this group are transports."""


class Condition(Enum):
    """What the motors are doing."""

    GONE = "gone"  # nobody knows: what drives them does not answer
    OFF = "off"  # without current
    ENABLING = "enabling"  # on their way home
    READY = "ready"  # held at home, or playing: a table is welcome
    BRAKING = "braking"


@dataclass(frozen=True)
class Report:
    """What a transport knows of the motors: what they report, not what was commanded.

    Attributes
    ----------
    condition : Condition
    reason : DriverReason
        Why they are off, brake or do not answer. A stop that was asked for is EARLIER_STOP: whether
        this driver asked for it, the driver knows. What is in no list is OTHER.
    text : str
        The same in words.
    values : mapping of str to str
        Whatever is worth a line in the diagnostics.
    """

    condition: Condition
    reason: DriverReason = DriverReason.NONE
    text: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Measured:
    """What sensors say of the motors.

    Attributes
    ----------
    time : float
        When it was measured, on the context's clock [s].
    device_s : float
        The same on the device's clock [s]: without the jitter of the host's idea of it.
    table : int
        Number of the table that plays; 0: none.
    position, acceleration : tuple of 4 float
        [m], [m/s2].
    playing : MotorTable or None
        The table that plays, where it is known; where its tail plays, that alone.
    began : float
        When this play of it began, on the context's clock [s].
    doubt : str
        Why these times are not believed; empty if they are.
    """

    time: float
    device_s: float
    table: int
    position: tuple[float, ...]
    acceleration: tuple[float, ...]
    playing: MotorTable | None = None
    began: float = float("nan")
    doubt: str = ""


class Order:
    """A stop, an enable or a home that was asked for, and what becomes of it.

    Parameters
    ----------
    longest_s : float
        Time within which there is an answer, if one comes at all [s].
    """

    def __init__(self, longest_s: float = 0.0) -> None:
        self.longest_s = longest_s
        self.failure = ""
        self._settled = threading.Event()

    @property
    def settled(self) -> bool:
        """Whether it is done, or has failed."""
        return self._settled.is_set()

    @property
    def done(self) -> bool:
        """Whether the motors' controller has said that it is done."""
        return self.settled and not self.failure

    def settle(self, failure: str = "") -> Order:
        """Say that it is done, or why not; only the first word counts."""
        if not self.settled:
            self.failure = failure
            self._settled.set()
        return self

    def wait(self, longest_s: float | None = None) -> bool:
        """Wait until it is settled, at most so long [s], or `longest_s` of its own; returns whether
        it is done."""
        self._settled.wait(self.longest_s if longest_s is None else max(0.0, longest_s))
        return self.done


class Transport(Protocol):
    """The way to the motors.

    Attributes
    ----------
    motors : bool
        Whether there are motors that need an enable. If not, the setpoints that the driver
        publishes are all there is: `send` publishes them, and nobody has to enable anything.
    calibrates : bool
        Whether what it measures is good for a calibration.
    max_knots : int
        Most knots of a table.
    hold_s : float
        Longest time for which a table is played again [s].
    """

    motors: bool
    calibrates: bool

    @property
    def max_knots(self) -> int: ...

    @property
    def hold_s(self) -> float: ...

    def open(self) -> None:
        """Make it ready to be asked; nothing moves by this. A PlateError ends the configuration:
        what may come later, such as a port, is no error, but waited for by `poll`; until it is
        there the report is GONE, and says for what."""

    def poll(self) -> list[Measured]:
        """Do what is due; returns what was measured since the last call."""

    def report(self) -> Report:
        """Say what the motors do."""

    def send(self, table: MotorTable, repeats: int) -> None:
        """Hand over a table, which ends at rest at home, and begins there or where another one is
        spliced.

        The motors take the newest at their next cycle boundary, play it `repeats` times unless
        another one comes, and rest by themselves then. One with a tail is played once: at its
        splice they take the newest if that begins there, and else play the tail.

        Raises
        ------
        CycleError
            If they take none now, or not this one: why.
        """

    def stop(self, cut: bool = False) -> Order:
        """Have them brake along their path, go home and lose their current, or lose it at once.

        Done when their controller has said so. Whatever was sent or asked before is forgotten.
        """

    def enable(self) -> Order:
        """Give them current once: a person has asked for it. Done when they are ready.

        A stop that comes later, and one that this was not given for, must win. Nothing else gives
        them current: not `open`, `send`, or a controller that comes back.
        """

    def home(self) -> Order:
        """Have them find home anew at the next enable; only while they are off."""

    def troubles(self) -> list[str]:
        """Return what went wrong since the last call, each in a line."""

    def values(self) -> dict[str, str]:
        """Return what is to be reported since the last call, name to value."""

    def close(self) -> None:
        """Have them stop, and release everything."""


@dataclass(frozen=True)
class TransportContext:
    """What a transport is made of.

    Attributes
    ----------
    rig : Rig
    publish : callable
        Publishes a table on motor_setpoints.
    clock : callable
        Time that never runs back [s].
    parameters : mapping of str to value
        Of the driver: `port`, `baud`, and all others.
    seed : int
        Another number in each process.
    """

    rig: Rig
    publish: Callable[[MotorTable], None]
    clock: Callable[[], float]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0


def installed() -> dict[str, EntryPoint]:
    """Return the transports that are installed, by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


def make_transport(name: str, context: TransportContext) -> Transport:
    """Return the transport with a name.

    Raises
    ------
    PlateError
        If it is not installed, cannot be loaded, or refuses a parameter.
    """
    known = installed()
    _check_name(name, known)
    try:
        make = known[name].load()
    except (ImportError, AttributeError) as error:
        raise PlateError(
            f"transport is {name!r}, allowed: one whose entry point {known[name].value} loads "
            f"({error})"
        ) from None
    made: Transport = make(context)
    return made


def check_transport(name: str, port: str) -> None:
    """Refuse a transport that is not installed, or lacks its port."""
    _check_name(name, installed())
    if name == "serial" and not port:
        raise PlateError("port is '', allowed with transport serial: the name of a serial port")


def _check_name(name: str, known: Iterable[str]) -> None:
    if name not in known:
        hint = did_you_mean(name, known)
        raise PlateError(f"transport is {name!r}{hint}, allowed: {', '.join(sorted(known))}")
