"""The firmware on an emulated STM32F405 (firmware/boards/stm32f405): what a tick costs, what it
commands, what stops it. Ticks are stepped, so that no test depends on how busy the machine is."""

import os
import re
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from board_host import (
    LINE_BYTES,
    SPEED,
    STROKE_M,
    WAIT_TICKS,
    Host,
    attack_board,
    upload_while_playing,
    wave_table,
)
from emulated_board import (
    INSTRUCTION_NS,
    NEEDS,
    RING_BYTES,
    EmulatedBoard,
    build_firmware,
    read_symbols,
    rig_without_following_check,
)
from tried_board import TriedBoard, assembled

from plate_core import PlateCycle, load_rig
from plate_core.serial_protocol import Enable, Fault, State, Status, Stop
from plate_driver.setpoints import MotorTable
from plate_driver.transports import Condition, SerialTransport
from plate_sim.device import DeviceLimits, c_header

ROOT = Path(__file__).resolve().parents[1]
BOARD = ROOT / "firmware" / "boards" / "stm32f405"

MOST = 42_000
"""Instructions of a tick: a quarter of 1 ms at 168 MHz."""

SLACK = 1.002
"""A limit may be passed by this factor (docs/protocol.md)."""

emulated = pytest.mark.needs(*NEEDS)


@pytest.fixture(name="watchful", scope="module")
def _watchful(tmp_path_factory):
    """Of config/rig.yaml."""
    elf = build_firmware(tmp_path_factory.mktemp("board"))
    return elf.rename(elf.with_stem("watchful"))


@pytest.fixture(name="firmware", scope="module")
def _firmware(watchful):
    """Without watch over the following error: an emulated plate never moves. Few objects differ."""
    folder = watchful.parent
    return build_firmware(
        folder, RIG=rig_without_following_check(ROOT / "config" / "rig.yaml", folder)
    )


def ready(board: EmulatedBoard) -> Host:
    host = Host(board)
    host.begin()
    assert host.enable() is Status.DONE
    assert host.now().state is State.READY
    return host


def numbers(text: str) -> dict[str, list[np.float32]]:
    """The values of `LIMITS` in C, by name."""
    [block] = re.findall(r"Limits LIMITS = \{(.*?)\n\};", text, re.DOTALL)
    found = re.findall(r"\.(\w+) = (.*?),(?=\s*(?:\.\w|$))", block, re.DOTALL)
    return {
        name: [np.float32(v) for v in re.findall(r"-?[\d.]+(?:e-?\d+)?(?=f)", values)]
        for name, values in found
    }


def expected(limits: DeviceLimits) -> dict[str, list[np.float32]]:
    return {k: [np.float32(v) for v in np.ravel(values)] for k, values in vars(limits).items()}


@pytest.mark.parametrize("path", ["boards/stm32f405/limits_default.h", "host/motors.c"])
def test_limits_in_c_are_those_of_the_rig_file(path):
    text = (ROOT / "firmware" / path).read_text(encoding="utf-8")
    limits = DeviceLimits.of_rig(load_rig(ROOT / "config" / "rig.yaml"))
    assert numbers(text) == expected(limits)


def test_limits_header_is_of_the_rig_that_is_named(tmp_path, monkeypatch, capsys):
    rig = yaml.safe_load((ROOT / "config" / "rig.yaml").read_text(encoding="utf-8"))
    rig["limits"] |= {"stroke_m": 0.0071, "following_error_m": 0.00123, "force_n": 7.25}
    rig["motors"]["motor_3"]["point_m"] = [-0.123, -0.15]
    path = tmp_path / "other.yaml"
    path.write_text(yaml.safe_dump(rig), encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["limits_header", str(path)])
    with pytest.raises(SystemExit) as end:
        runpy.run_module("plate_sim.device.limits_header", run_name="__main__")
    assert end.value.code == 0
    text = capsys.readouterr().out
    limits = DeviceLimits.of_rig(load_rig(path))
    assert numbers(text) == expected(limits)
    assert text == c_header(limits, "other.yaml")


@emulated
def test_image_has_no_double_no_heap_and_no_streams(firmware):
    names = read_symbols(firmware)
    assert {"tick", "controller_tick", "table_at"} <= set(names)
    banned = re.compile(
        r"__aeabi_(?!u?l|mem|u?idiv)\w*d\w*|__\w+df\w*|_?malloc\w*|_?free\w*|_sbrk\w*|\w*printf\w*"
        r"|_?(?:write|read|open|close|fstat|isatty|lseek)(?:_r)?"
    )
    assert [name for name in names if banned.fullmatch(name)] == []
    # The expression finds the expected text.
    for name in ("__aeabi_dmul", "__aeabi_f2d", "__aeabi_d2f", "__adddf3", "malloc", "_sbrk"):
        assert banned.fullmatch(name)


QUICKLY = "CFLAGS=-std=c99 -O0 -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard"
"""Halves the compilation time of the program, which is not run."""


class Bench:
    """A shell outside the environment, with a programmer that records its arguments."""

    def __init__(self, folder: Path) -> None:
        self.build = folder / "build"
        self.flashed = folder / "flashed"
        programmer = folder / "openocd"
        programmer.write_text(f'#!/bin/sh\necho "$@" >> {self.flashed}\n', encoding="utf-8")
        programmer.chmod(0o755)
        self.rig = folder / "my rig.yaml"
        facts = yaml.safe_load((ROOT / "config" / "rig.yaml").read_text(encoding="utf-8"))
        facts["limits"] |= {"stroke_m": 0.0071, "force_n": 12.5, "following_error_m": 0}
        self.rig.write_text(yaml.safe_dump(facts), encoding="utf-8")
        self.environment = {"PATH": f"{folder}:{os.environ['PATH']}"}

    def make(self, *arguments: str) -> tuple[int, str, str]:
        """Return code, output and errors of a make in the board's folder."""
        command = ["make", "-s", "-C", str(BOARD), f"BUILD={self.build}", QUICKLY, *arguments]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=120, env=self.environment
        )
        return done.returncode, done.stdout, done.stderr

    def refused(self, *arguments: str) -> str:
        """Return the one line with the reason why a make was refused; nothing was flashed."""
        before = self.flashes()
        code, _, errors = self.make(*arguments)
        assert code
        [line] = [line for line in errors.splitlines() if not line.startswith("make: ***")]
        assert self.flashes() == before
        return line

    def flashes(self) -> list[str]:
        return (
            self.flashed.read_text(encoding="utf-8").splitlines() if self.flashed.exists() else []
        )

    def image(self) -> bytes:
        return (self.build / "plate.bin").read_bytes()


@pytest.fixture(name="bench")
def _bench(tmp_path):
    return Bench(tmp_path)


STANDARD = "limits of the original config/rig.yaml (RIG is not set)"


@emulated
def test_flash_uses_the_named_build_and_reports_it(bench):
    assert "nothing is built" in bench.refused("flash")
    code, output, _ = bench.make()
    assert code == 0
    assert STANDARD in output
    assert "stroke 0.01 m" in output
    standard = bench.image()
    assert bench.make(f"RIG={bench.rig}")[0] == 0
    image = bench.image()
    assert image != standard
    code, output, _ = bench.make("flash")
    assert code == 0
    assert f"limits of {bench.rig}; CRYSTAL_MHZ 8, BAUD 921600" in output
    for limit in (
        "stroke 0.0071 m", "speed 1.0 m/s", "acceleration 100.0 m/s2", "force 12.5 N",
        "following error not monitored",
    ):  # fmt: skip
        assert limit in output
    assert bench.image() == image
    [call] = bench.flashes()
    assert f"program {bench.build}/plate.elf verify reset exit" in call
    # It refuses uncertain values.
    assert "BAUD 460800" in bench.refused("flash", "BAUD=460800")
    assert STANDARD in bench.refused("flash", "RIG=")
    later = (bench.build / "plate.txt").stat().st_mtime + 1
    os.utime(bench.rig, (later, later))
    assert f"{bench.rig} is newer" in bench.refused("flash")
    os.utime(bench.rig, (1, 1))
    assert bench.make("flash")[0] == 0
    # A build remembers its options.
    assert bench.make("CRYSTAL_MHZ=25")[0] == 0
    before = bench.image()
    code, output, _ = bench.make("BAUD=460800")
    assert code == 0
    remembered, image = f"limits of {bench.rig}; CRYSTAL_MHZ 25, BAUD 460800", bench.image()
    assert remembered in output
    assert image != before
    assert numbers((bench.build / "limits_rig.h").read_text(encoding="utf-8")) == expected(
        DeviceLimits.of_rig(load_rig(bench.rig))
    )
    # One that fails leaves nothing to flash, and is not remembered.
    assert "none.yaml: no such file" in bench.refused("RIG=/none.yaml")
    assert "nothing is built" in bench.refused("flash")
    assert bench.make("CRYSTAL_MHZ=12")[0]
    assert "nothing is built" in bench.refused("flash")
    code, output, _ = bench.make("all", "flash")
    assert code == 0
    assert remembered in output
    assert bench.image() == image
    code, output, _ = bench.make("RIG=")
    assert code == 0
    assert STANDARD in output


def test_build_without_the_projects_python_reports_a_remedy(bench):
    line = bench.refused(f"RIG={bench.rig}", "PYTHON=no_python")
    assert "no_python" in line
    assert f"run make setup in {ROOT}, or source its env.sh" in line


@emulated
def test_an_instruction_is_eight_nanoseconds(tmp_path):
    """The timer by which ticks are measured, over loops whose instructions are counted by hand."""
    rounds = (1_000, 5_000)
    took = []
    for count in rounds:
        elf = assembled(LOOP.replace("ROUNDS", str(count)), tmp_path / f"loop{count}.elf")
        with EmulatedBoard(elf, idle="took") as board:
            took.append(int.from_bytes(board.memory("took", 4), "little"))
    # Four instructions a round.
    assert took[1] - took[0] == 4 * (rounds[1] - rounds[0]) * INSTRUCTION_NS


LOOP = """
    .syntax unified
    .cpu cortex-m4
    .thumb
    .section .vectors, "a"
    .word 0x20002000, start
    .text
    .thumb_func
    .global start
start:
    ldr r0, =0x40000000     @ TIM2: all of its 32 bits, on
    mvn r1, #0
    str r1, [r0, #0x2c]
    movs r1, #1
    str r1, [r0]
    ldr r2, =ROUNDS
    ldr r3, [r0, #0x24]
again:
    nop
    nop
    subs r2, #1
    bne again
    ldr r4, [r0, #0x24]
    subs r4, r3
    ldr r5, =took
    str r4, [r5]
stay:
    ldr r4, [r5]            @ where the emulator stops
    b stay
    .bss
    .global took
took: .space 4
"""


@emulated
def test_a_tick_is_bounded_while_tables_small_and_large_come(firmware):
    with EmulatedBoard(firmware) as board:
        host = ready(board)
        for table, pieces in enumerate((48, 500)):
            status, ticks = upload_while_playing(host, pieces, 10 * table + 1)
            assert status is Status.DONE
            assert ticks.median < ticks.worst <= MOST
        assert_moved_within_limits(board.record())
        assert host.now().faults is Fault.NONE
        assert host.refused == 0


@emulated
@pytest.mark.parametrize(
    ("rig", "drives", "most_m"),
    [("linear_motors", "ideal_drives", 1e-5), ("odrives", "ideal_odrives", 1e-3)],
)
def test_a_tick_is_bounded_with_drives_on_a_bus(tmp_path, rig, drives, most_m):
    """Of drives that follow at once, built into the image: there is no CAN controller.

    Of an ODrive the mean of two setpoints is expected, 1 mm behind the last one at 1 m/s.
    """
    rig = ROOT / "config" / "rigs" / f"{rig}.yaml"
    firmware = build_firmware(tmp_path, RIG=rig, CAN=ROOT / "test" / f"{drives}.c")
    with EmulatedBoard(firmware) as board:
        for _ in range(400):
            board.tick()
        host = ready(board)
        status, ticks = upload_while_playing(host, 500, 1)
        assert status is Status.DONE
        assert 1000 < ticks.median < ticks.worst <= MOST
        reported = host.telemetry[-100:]
        assert {message.state for message in reported} >= {State.PLAYING}
        assert max(abs(q) for message in reported for q in message.position) > 1e-3
        assert max(message.following_m for message in host.telemetry) < most_m
        assert host.now().faults is Fault.NONE


@emulated
def test_a_tick_is_bounded_where_a_table_takes_over_in_motion(firmware):
    knots, middle = wave_table(500, 0.9), 250
    splice = knots[middle].ticks
    rest = tuple(replace(knot, ticks=knot.ticks - splice) for knot in knots[middle:])
    with EmulatedBoard(firmware) as board:
        host = ready(board)
        assert host.upload(1, knots, 1, splice) is Status.DONE
        host.until(lambda: host.now().state is State.PLAYING)
        first = len(host.telemetry)
        before = board.record()
        assert host.upload(2, rest) is Status.DONE
        assert host.now().table == 1  # it waits for the splice
        host.until(lambda: host.now().table == 2)
        host.until(lambda: host.now().state is State.READY)
        assert host.ticks_since(before, first).worst <= MOST
        assert {m.table for m in host.telemetry[first:]} == {0, 1, 2}
        assert_moved_within_limits(board.record())
        # And where none does: along the tail.
        assert host.upload(3, knots, 1, splice) is Status.DONE
        host.until(lambda: host.now().ticks > splice)
        host.until(lambda: host.now().state is State.READY)
        assert host.now().faults is Fault.NONE


@emulated
def test_the_work_of_a_tick_is_limited_for_any_input(firmware):
    with EmulatedBoard(firmware) as board:
        host = Host(board, pace=128)
        host.begin()
        host.enable()
        attack, ticks = attack_board(host, 1200, seed=48)  # one that has all kinds
        assert ticks.worst <= MOST
        assert len(attack.kinds) == 7
        record = board.record()
        assert record.late == 0
        assert_moved_within_limits(record)


def assert_moved_within_limits(record: np.record) -> None:
    assert 0 < record.step_m <= SPEED * 1e-3 * SLACK
    assert record.most[0] <= STROKE_M * SLACK
    assert record.most[1] <= SPEED * SLACK
    assert record.most[0] > 0.8 * STROKE_M


@emulated
def test_the_current_is_switched_off_if_the_plate_does_not_follow(watchful, tmp_path):
    """Nothing moves in an emulator: as a jammed plate, held 2 mm from its setpoint."""
    with TriedBoard(watchful, tmp_path) as board:
        host = ready(board)
        assert host.upload(1, wave_table(48, 0.2, 0.6)) is Status.DONE
        host.until(lambda: host.now().state is State.PLAYING)
        host.until(lambda: host.now().state is State.READY)
        assert board.enabled()
        assert host.upload(2, wave_table(48, 0.5, 0.6)) is Status.DONE
        host.until(lambda: host.now().state is State.OFF)
        assert host.telemetry[-1].faults is Fault.FOLLOWING
        assert max(m.following_m for m in host.telemetry) > 0.003
        assert not board.enabled()


@emulated
def test_a_stop_takes_the_enable_pin_down(firmware, tmp_path):
    for now in (0, 1):
        folder = tmp_path / str(now)
        folder.mkdir()
        with TriedBoard(firmware, folder) as board:
            host = Host(board)
            host.begin()
            host.rest(50)
            assert not board.enabled()
            host.enable()
            assert board.enabled()
            host.upload(1, wave_table(48), 3)
            host.until(lambda host=host: host.now().state is State.PLAYING)
            assert host.ask(Stop(now)) is Status.DONE
            if now:
                assert not board.enabled()
            host.until(lambda host=host: host.now().state is State.OFF)
            assert host.telemetry[-1].faults is Fault.STOPPED
            assert not board.enabled()
            fed = sum(value == 0xAAAA for _, _, value in board.written())
            assert abs(fed - board.record().ticks) <= 2  # the watchdog, in each tick


@emulated
def test_after_a_crash_the_enable_pin_is_low_and_the_watchdog_is_not_fed(firmware, tmp_path):
    with TriedBoard(firmware, tmp_path) as board:
        ready(board)
        assert board.enabled()
        board.jump(0x1000_0001)  # where there is nothing
        assert not board.enabled()
        boots, crashes, _ = np.frombuffer(board.memory("survivor", 12), np.uint32)
        assert (boots, crashes) == (1, 1)
        fed = sum(value == 0xAAAA for _, _, value in board.written())
        board.walk(1000)
        assert sum(value == 0xAAAA for _, _, value in board.written()) == fed > 0


@emulated
def test_a_stop_stays_over_reset_and_cable(firmware, tmp_path):
    with TriedBoard(firmware, tmp_path) as board:
        host = ready(board)
        old = host.now().stop
        assert host.ask(Stop(0)) is Status.DONE
        stop = host.now().stop
        assert stop != old
        host = Host(board)  # the cable is in another computer
        host.begin()
        host.rest(100)
        reported = host.now()
        assert (reported.state, reported.faults, reported.stop) == (State.OFF, Fault.STOPPED, stop)
        board.reset()
        host = Host(board)
        host.until(lambda: host.telemetry)
        assert host.ask(Enable(stop)) is Status.NO_SESSION
        assert board.memory("driving", 1) == b"\0"
        host.begin()
        assert host.ask(Enable(stop)) is Status.WRONG_STOP
        assert host.upload(1, wave_table(48, 0.5)) is Status.WRONG_STATE
        host.rest(100)
        reported = host.now()
        assert (reported.state, reported.faults) == (State.OFF, Fault.NO_HOME)
        assert board.memory("driving", 1) == b"\0"
        assert np.frombuffer(board.memory("survivor", 4), np.uint32)[0] == 2
        assert host.enable() is Status.DONE
        assert host.now().state is State.READY
        assert board.memory("driving", 1) == b"\1"


@emulated
def test_the_line_loses_no_byte(firmware, tmp_path):
    """QEMU's own line brings a byte when the one before was taken, more than the ring holds."""
    with TriedBoard(firmware, tmp_path) as board:
        host = Host(board)
        host.begin()
        host.now()
        before = board.record().received
        data = b"".join(host.again() for _ in range(1 + RING_BYTES // 10))
        board.write(data)
        for tick in range(WAIT_TICKS):
            if tick % 100 == 0 and board.record().received >= before + len(data):
                break
            board.tick()
        record = board.record()
        assert len(data) > RING_BYTES
        assert record.received == before + len(data)
        assert (record.overruns, host.now().refused, host.refused) == (0, 0, 0)


class BoardPort:
    """The board's line as the driver's port; its time [s] is that of the board."""

    def __init__(self, board: EmulatedBoard) -> None:
        self._board, self.now = board, 0.0
        self._written = self._said = b""

    def pass_tick(self) -> None:
        size = min(LINE_BYTES, self._board.free_bytes())
        came, self._written = self._written[:size], self._written[size:]
        self._said += self._board.tick(came)
        self.now += 1e-3

    def read(self, size: int) -> bytes:
        reported, self._said = self._said[:size], self._said[size:]
        return reported

    def write(self, data: bytes) -> int:
        self._written += data
        return len(data)

    def close(self) -> None:
        pass


@emulated
def test_the_driver_plays_on_the_board(firmware):
    """The driver's own transport, in the board's time."""
    rig = load_rig()
    knots = wave_table(48)
    q, qd, qdd = (
        np.array([getattr(k, name) for k in knots])
        for name in ("position", "velocity", "acceleration")
    )
    times = np.array([k.ticks * 1e-8 for k in knots])
    cycle = PlateCycle.from_knots(times, *np.zeros((3, len(knots), 3)))
    table = MotorTable(0, cycle, q, qd, qdd)
    assert rig.limits.stroke_m == STROKE_M
    with EmulatedBoard(firmware) as board:
        port = BoardPort(board)
        transport = SerialTransport(lambda: port, lambda: port.now, 1)
        transport.open()

        def until(reached):
            while not reached():
                assert port.now < 10, (transport.report(), transport.troubles())
                port.pass_tick()
                transport.poll()

        until(lambda: transport.report().condition is Condition.OFF)
        order = transport.enable()
        until(lambda: transport.report().condition is Condition.READY)
        assert order.done
        transport.send(table, 2)
        most = np.max(np.abs(q))
        until(lambda: board.record().most[0] > 0.99 * most)
        assert board.record().most[0] == pytest.approx(most, rel=0.01)
        order = transport.stop(cut=True)
        until(lambda: transport.report().condition is Condition.OFF)
        assert order.done
        transport.close()
