"""Reads the objects of all drives on a bus, and compares them with the rig file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from plate_core import PlateError, Rig
from plate_core.rig import Drive, Limits, RigWarning
from plate_core.serial_protocol import Trouble, emergency_text

from .master import Master, Refused, trouble_text

OBJECTS = {
    "device type": (0x1000, 0), "vendor": (0x1018, 1), "serial": (0x1018, 4), "modes": (0x6502, 0),
    "status": (0x6041, 0), "error": (0x603F, 0), "register": (0x1001, 0), "position": (0x6064, 0),
    "lowest": (0x607D, 1), "highest": (0x607D, 2), "speed": (0x607F, 0), "window": (0x6065, 0),
    "period": (0x60C2, 1), "exponent": (0x60C2, 2), "consumer": (0x1016, 1), "abort": (0x6007, 0),
}  # fmt: skip
"""Objects that are read from each node: name, index and subindex."""
SIGNED = ("position", "lowest", "highest", "exponent")

NEEDED = ("consumer", "abort", "exponent")
"""Names of the objects that a drive must have. The drive needs them to stop if its master fails,
and to interpolate setpoints."""

PROFILE, CYCLIC_POSITION, UNWATCHED = 402, 1 << 7, 2**32 - 1


def has_current(status: int) -> bool:
    """Whether a drive with this statusword has current. A drive has current in operation and during
    its quick stop."""
    return status & 0x6F in (0x27, 0x07)


def is_in_fault(status: int) -> bool:
    """Whether a drive with this statusword is in the state fault or fault reaction."""
    return status & 0x48 == 0x08


@dataclass(frozen=True)
class BusNode:
    """A node on the bus.

    Attributes
    ----------
    node : int
        Number of the node.
    values : mapping of str to int
        Values of the node's objects, by the names of `OBJECTS`.
    refusals : mapping of str to str
        Errors for objects that could not be read, by the names of `OBJECTS`.
    twice : bool
        Whether several nodes on the bus have this number.
    """

    node: int
    values: Mapping[str, int]
    refusals: Mapping[str, str]
    twice: bool

    @property
    def is_drive(self) -> bool:
        """Whether the node is a CiA 402 drive."""
        return self.values.get("device type", 0) & 0xFFFF == PROFILE

    def __str__(self) -> str:
        known, status = self.values, self.values.get("status", 0)
        state = "in fault" if is_in_fault(status) else "without current"
        return (
            f"node {self.node}: device type {known.get('device type', 0):X}h, vendor "
            f"{known.get('vendor', 0):X}h, serial {known.get('serial', 0)}, position "
            f"{known.get('position', 0)}, interpolates over {known.get('period', 0)}e"
            f"{known.get('exponent', 0)} s, {'WITH CURRENT' if has_current(status) else state}"
        )


def read_bus(master: Master) -> dict[int, BusNode]:
    """Read all nodes on the bus, and return them by their numbers. No object is written.

    Raises
    ------
    PlateError
        If the bus fails, or a node does not reply to a later request.
    """
    found = {}
    for node in master.answering(0x1000):
        twice, values, refusals = len(master.received[node].answers) > 1, {}, {}
        for name, (index, sub) in OBJECTS.items():
            try:
                values[name] = master.read(node, index, sub, name in SIGNED)
            except Refused as error:
                refusals[name] = str(error)
        found[node] = BusNode(node, values, refusals, twice)
    return found


def drives_of(rig: Rig) -> list[Drive]:
    """Return the drives of motor_1 to motor_4. Raise a PlateError if the rig file names other
    drives than CiA 402."""
    drives = [motor.drive for motor in rig.motors if motor.drive is not None]
    kinds = {drive.kind for drive in drives} or {"bridge"}
    if kinds != {"cia402"}:
        raise PlateError(f"motors: drive is {', '.join(kinds)}, allowed in this program: cia402")
    return drives


def bus_warnings(
    rig: Rig, found: Mapping[int, BusNode], other_master: bool
) -> Iterator[RigWarning]:
    """Yield the differences between the drives on the bus and the rig file. If a difference is
    `impossible`, it must be corrected before motors are moved."""
    if other_master:
        yield RigWarning("bus", trouble_text(0, Trouble.OTHER_MASTER), True)
    drives = drives_of(rig)
    for number, drive in enumerate(drives, 1):
        for text in _compare_drive(number, drive, found):
            yield RigWarning("motors", text, True)
        drive_on_bus = found.get(drive.node)
        for text, wrong in (
            _compare_limits(drive, drive_on_bus, rig.limits)
            if drive_on_bus and drive_on_bus.is_drive
            else ()
        ):
            yield RigWarning("limits", f"motor_{number}: {text}", wrong)
    for node in sorted(set(found) - {drive.node for drive in drives}):
        yield RigWarning("bus", f"node {node} is on the bus but not in the rig file")


def _compare_drive(number: int, drive: Drive, found: Mapping[int, BusNode]) -> Iterator[str]:
    name, node, drive_on_bus = f"motor_{number}", drive.node, found.get(drive.node)
    same = [k for k, n in found.items() if drive.serial and n.values.get("serial") == drive.serial]
    swapped = f"; the serial number of the rig file is at node {same[0]}" if same else ""
    if drive_on_bus is None:
        others = ", ".join(map(str, sorted(found))) or "none"
        yield f"{name}: node {node} does not answer, nodes on the bus: {others}{swapped}"
        return
    device, modes, serial, status, code, register = (
        drive_on_bus.values.get(name, 0)
        for name in ("device type", "modes", "serial", "status", "error", "register")
    )
    if drive_on_bus.twice:
        yield trouble_text(number, Trouble.TWICE)
    if not drive_on_bus.is_drive:
        yield f"{name}: node {node} has device type {device:X}h, allowed: profile {PROFILE}"
        return
    if not modes & CYCLIC_POSITION:
        yield f"{name}: modes 6502h are {modes:X}h, required: cyclic synchronous position"
    if drive.serial not in (0, serial):
        yield f"{name}: node {node} has serial {serial}, allowed: {drive.serial}{swapped}"
    for needed in set(NEEDED) & set(drive_on_bus.refusals):
        yield f"{name}: {drive_on_bus.refusals[needed]}, so it cannot be controlled"
    if is_in_fault(status):
        why = f"error code {code:04X}h{emergency_text(code)}, error register {register:02X}h"
        yield f"{trouble_text(number, Trouble.FAULT, code=status)}: {why}"
    elif has_current(status):
        yield (
            f"{name}: the drive has current (statusword {status:04X}h), allowed: no current. "
            "Another program may control it"
        )


def _compare_limits(
    drive: Drive, drive_on_bus: BusNode, limits: Limits
) -> Iterator[tuple[str, bool]]:
    """Yield a text about each limit of the drive that is missing, or that is stricter than the
    limits of the rig. Also yield whether the text describes an error."""
    low, high, speed, window = (
        drive_on_bus.values.get(name, 0) / drive.counts_per_m
        for name in ("lowest", "highest", "speed", "window")
    )
    stroke, following = limits.stroke_m, limits.following_error_m
    span = f"position range limits 607Dh are {1e3 * low:.4g} to {1e3 * high:.4g} mm"
    if low >= high:
        yield "position range limits 607Dh are not set, so only the rig's stroke_m applies", False
    elif high - low < 2 * stroke:
        yield f"{span}, allowed: {2e3 * stroke:g} mm or more (stroke_m to both sides)", True
    elif drive.absolute and max(low, -high) > -stroke:
        needed = f"limits beyond stroke_m ({1e3 * stroke:g} mm)"
        yield f"{span}, but home absolute requires {needed}", True
    if 0 < speed < limits.speed:
        need = f"allowed: the rig's speed_mps ({limits.speed:g} m/s) or more"
        yield (
            f"max profile velocity 607Fh is {speed:.3g} m/s (if its unit is counts/s), {need}",
            False,
        )
    if drive_on_bus.values.get("window", 0) in (0, UNWATCHED):
        yield (
            "following error window 6065h is not set, so the drive does not check its error",
            False,
        )
    elif window < following:
        yield (
            f"following error window 6065h is {1e3 * window:.3g} mm, so the drive stops before "
            f"the rig's following_error_m ({1e3 * following:g} mm) is reached", False,
        )  # fmt: skip
