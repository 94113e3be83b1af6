"""Changes written into a rig file: the rest of the file keeps its form."""

from dataclasses import replace

import pytest

from plate_core import PlateError, load_rig
from plate_core.rig import Drive, rig_path
from plate_drives.rig_file import write

MOTOR_2 = """  motor_2:                 # left
    point_m: [-0.30, -0.10]
    direction: [1, 0]
    drive: cia402
    counts_per_m: 1.0e6    # by its label
    node: 2                # of the switch
"""


@pytest.fixture(name="path")
def _path(tmp_path):
    text = rig_path("linear_motors").read_text(encoding="utf-8")
    start, end = text.index("  motor_2:"), text.index("  motor_3:")
    path = tmp_path / "rig.yaml"
    path.write_text(text[:start] + MOTOR_2 + text[end:], encoding="utf-8")
    return path


def test_values_change_and_all_else_stays(path):
    before, rig = path.read_text(encoding="utf-8"), load_rig(path)
    path.chmod(0o640)
    new = {"motor_1": Drive(9, 2.5e5, -1, True, 77), "motor_2": Drive(2, 1e6, -1, serial=4711)}
    write(path, new)
    after = load_rig(path)
    assert after == replace(
        rig, motors=tuple(replace(m, drive=new.get(m.name, m.drive)) for m in rig.motors)
    )
    added = {
        "node: 1, counts_per_m: 1.0e6}":
        "node: 9, counts_per_m: 250000, sign: -1, home: absolute, serial: 77}",
        "    node: 2                # of the switch\n":
        "    node: 2                # of the switch\n    sign: -1\n    serial: 4711\n",
    }  # fmt: skip
    for old, there in added.items():
        before = before.replace(old, there)
    assert path.read_text(encoding="utf-8") == before
    assert path.stat().st_mode & 0o777 == 0o640
    assert list(path.parent.iterdir()) == [path]


def refused(path, drives, text):
    before = path.read_bytes()
    with pytest.raises(PlateError, match=text):
        write(path, drives)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_file_that_would_be_wrong_is_not_written(path):
    refused(path, {"motor_1": Drive(2, 1e6)}, "motor_2: node is 2, .*motor_1")


def test_a_form_that_cannot_be_changed_in_one_place_is_not_written(path):
    text = path.read_text(encoding="utf-8")
    text = text.replace("counts_per_m: 1.0e6 ", "counts_per_m: *c ")
    path.write_text(text.replace("1.0e6}", "&c 1.0e6}", 1), encoding="utf-8")
    refused(path, {"motor_1": Drive(1, 2e6)}, "was not changed, .*by hand: .* alias 'c'")


def test_the_target_of_a_symbolic_link_is_written(path):
    link = path.with_name("link.yaml")
    link.symlink_to(path)
    write(link, {"motor_1": Drive(1, 1e6, -1)})
    assert link.is_symlink()
    assert load_rig(path).motors[0].drive == Drive(1, 1e6, -1)
