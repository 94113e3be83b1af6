"""Faults of a drive on CAN: each function causes one, in a bench and a drive."""

from device_orders import live

SYNC = 0x80
"""CAN id of the message that starts a cycle of all drives."""


def lose_heartbeat(bench, drive):
    drive.nmt.stop_heartbeat()


def reset(bench, drive):
    drive.boot()


def emergency(bench, drive):
    drive.fail(0x8611, 0x20)


def low_voltage(bench, drive):
    drive.fail(0x3220, 0x04)


def jam(bench, drive):
    bench.plate, drive.jammed = None, True


def mute(bench, drive):
    drive.mute = True


def entered(state):
    def enter(bench, drive):
        drive.enter(state)

    return enter


def doubled(bench, drive):
    """Wake up a second drive with the same number."""
    cob, data = 0x180 + drive.id, bytes.fromhex("3702efbeadde")
    bench.network.subscribe(SYNC, lambda *_: bench.network.send_message(cob, data))


def pre_operational(bench, drive):
    drive.nmt.state = "PRE-OPERATIONAL"
    bench.network.send_message(0x700 + drive.id, b"\x7f")  # the drive's heartbeat, which is due now


def second_master(bench, drive):
    bench.network.send_message(SYNC, b"")


def other_client(bench, drive):
    bench.network.send_message(0x600 + drive.id, bytes.fromhex("2f60600001000000"))


def other_heartbeat(bench, drive):
    bench.network.send_message(0x77F, b"\x05")


def short_emergency(bench, drive):
    bench.network.send_message(0x80 + drive.id, b"\x10\x23")


def local(bench, drive):
    drive.remote = False


def bus_off(bench, drive):
    bench.order("busoff")


def stopped(bench, drive):
    """Stop the drive by NMT: it then obeys neither PDO nor SDO."""
    drive.nmt.state = "STOPPED"
    answer = drive.sdo.on_request

    def deaf(*request):
        if drive.nmt.state != "STOPPED":
            answer(*request)

    bench.network.unsubscribe(0x600 + drive.id, answer)
    bench.network.subscribe(0x600 + drive.id, deaf)


def moved_in_bus_off(bench, drive):
    bench.order("busoff")
    live(bench, 1020)
    drive.position += 3000  # the drive may have another origin
