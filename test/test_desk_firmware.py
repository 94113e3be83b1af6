"""The firmware on this computer with simulated drives, as with `make demo TRANSPORT=cia402` or
odrive."""

from itertools import pairwise

import numpy as np
import pytest
from device_orders import HELLO, say, spline, uploaded, wave
from graph.firmware import build

from plate_core import PlateError, load_rig
from plate_core.serial_protocol import Enable, Heartbeat, Reader, State, Telemetry, parse
from plate_sim.device import FirmwareOnDesk


@pytest.fixture(name="desk", params=[("cia402", "linear_motors"), ("odrive", "odrives")])
def _desk(tmp_path, request):
    kind, rig = request.param
    desk = FirmwareOnDesk(build(rig, kind, tmp_path), load_rig(rig))
    yield desk
    desk.close()


def passed(desk, ms):
    segments = []
    for k in range(ms):
        if k % 50 == 0:
            desk.to_device.sent(say(1, Heartbeat(1)), desk.now)
        segments += desk.tick()
    return segments


def test_the_motors_are_where_the_drives_have_brought_them(desk):
    passed(desk, 400)
    desk.to_device.sent(HELLO, desk.now)
    passed(desk, 50)
    reported = Reader().fed(desk.to_host.arrived(desk.now))[1]
    stop = [m for m in (parse(p).message for p in reported) if isinstance(m, Telemetry)][-1].stop
    desk.to_device.sent(say(101, Enable(stop)), desk.now)
    passed(desk, 900)
    assert (desk.state, desk.faults) == (State.READY, 0)
    for data in uploaded(7, wave(0.004), 102, 40):
        desk.to_device.sent(data, desk.now)
    segments = passed(desk, 1200)
    assert desk.state is State.PLAYING
    times = np.concatenate([s.start + s.times[:-1] for s in segments])
    places = np.concatenate([s.motors[:-1, 0] for s in segments])
    gaps = [b.start - a.end for a, b in pairwise(segments)]
    assert np.max(np.abs(gaps)) < 1e-9
    late, curve = times > times[-1] - 0.5, spline(wave(0.004))

    def miss(shift):
        return np.max(np.abs(curve((times[late] - shift) % 0.1) - places[late]))

    best = min(
        np.arange(0, 0.1, 2.5e-4), key=miss
    )  # when a play began, and how late the motors are
    assert 0 < miss(best) < 1.5e-4  # they lag, by little
    assert 0.3 < desk.check.fractions[0] < 0.5
    assert np.all(desk.check.fractions < 1)


@pytest.mark.parametrize(("rig", "has"), [("desk", "bridge"), ("odrives", "odrive")])
def test_a_rig_without_such_drives_is_refused(tmp_path, rig, has):
    with pytest.raises(
        PlateError, match=rf"rig {rig}.yaml: its motors have {has}, allowed: cia402"
    ):
        build(rig, "cia402", tmp_path)
