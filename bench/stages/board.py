"""The firmware on an emulated STM32F405: instructions per tick, and maximum steps of setpoints."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from board_host import Host, Ticks, attack_board, upload_while_playing
from emulated_board import NEEDS, EmulatedBoard, build_firmware, rig_without_following_check
from needs import packages, program

from harness import ROOT, Result, Table
from plate_core import PlateError
from plate_core.serial_protocol import Status

PIECES = (1, 2, 8, 24, 48, 96, 200, 500)
PACKETS = 10_000
LINES = (92, 128)
"""Bytes that arrive per tick: the number at 921,600 baud, and the maximum number that the firmware
reads in a tick."""


def measure(quick: bool) -> Result:
    """Commit tables of all sizes while another table plays. Then send malformed packets at the
    maximum rate. A quick measurement uses fewer tables and packets."""
    if lacking := packages([need for need in NEEDS if program(need) is None]):
        raise PlateError(
            f"the tools that build and emulate the board are missing: apt install {lacking}"
        )
    pieces, packets = ((1, 48, 500), 500) if quick else (PIECES, PACKETS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        elf = build_firmware(
            folder, RIG=rig_without_following_check(ROOT / "config" / "rig.yaml", folder)
        )
        commits = commit_rows(elf, pieces)
        attacks = [attack_row(elf, pace, packets) for pace in LINES]
    return Result([Table.of("commits", commits), Table.of("attacks", attacks)])


def commit_rows(elf: Path, pieces: tuple[int, ...]) -> list[dict[str, Any]]:
    """Return a row for a table of each size. All tables are sent to the same emulated board."""
    rows = []
    with EmulatedBoard(elf) as board:
        host = Host(board)
        host.begin()
        host.enable()
        for number, count in enumerate(pieces):
            status, ticks = upload_while_playing(host, count, 2 * number + 1)
            rows.append({"pieces": count, "answer": Status(status).name, **row_of(ticks)})
    return rows


def attack_row(elf: Path, pace: int, packets: int) -> dict[str, Any]:
    """Return the row of a board that receives malformed packets, `pace` bytes per tick."""
    with EmulatedBoard(elf) as board:
        host = Host(board, pace)
        host.begin()
        host.enable()
        attack, ticks = attack_board(host, packets, seed=1)
        kinds = ", ".join(f"{kind} {count}" for kind, count in sorted(attack.kinds.items()))
        return {
            "bytes": pace,
            "packets": sum(attack.kinds.values()),
            "kinds": kinds,
            "refused": host.now().refused,
            **row_of(ticks),
        }


def row_of(ticks: Ticks) -> dict[str, Any]:
    """Return tick lengths as the columns of a row."""
    return {
        "median": round(ticks.median),
        "worst": ticks.worst,
        "step_mm": 1e3 * ticks.step_m,
        "speed": ticks.most[1],
        "late": ticks.late,
    }
