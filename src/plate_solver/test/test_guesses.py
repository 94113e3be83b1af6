"""The table of first guesses: near what is asked, the same for a seed, kept on disk."""

import numpy as np
import pytest

from plate_solver import average_force
from plate_solver.guesses import GuessTable, cache_folder, guess_table
from plate_solver.harmonics import harmonics
from plate_solver.solution import Bounds

PLACE, PUSH = np.array([[0.12, -0.06]]), np.array([[0.1, 0.0]])


def test_guesses_are_near_what_is_asked(rig, scene):
    family = harmonics(2, 0.05, False)
    table = GuessTable.make(rig, 2, False, seed=1, size=3000)
    bounds = Bounds.of(rig)
    near, far = [], []
    for seed in range(20):
        rng, position = scene(seed, 1)
        force = rng.uniform(-0.15, 0.15, (1, 2))
        best, other = table.nearest(position, force, count=2)
        assert best.shape == (family.size, 3)
        assert np.any(best != other)
        for guess, misses in ((best, near), (family.random(rng, bounds), far)):
            miss = average_force(family.cycle(guess), position) - force
            misses.append(np.hypot(*miss[0]))
    assert np.median(near) < 0.5 * np.median(far)


@pytest.mark.parametrize(("number", "at_rest"), [(2, False), (3, True)])
def test_a_tables_forces_are_those_of_its_motions(rig, number, at_rest):
    table = GuessTable.make(rig, number, at_rest, size=12)
    basis = harmonics(number, 0.1, at_rest)
    for motion, place, force in zip(table.coefficients, table.position, table.force, strict=True):
        np.testing.assert_allclose(
            average_force(basis.cycle(motion), place[None])[0], force, atol=2e-4
        )


def test_same_seed_same_table(rig):
    first, again, other = (GuessTable.make(rig, 2, False, seed, size=50) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.nearest(PLACE, PUSH), again.nearest(PLACE, PUSH))
    assert np.any(np.array(first.nearest(PLACE, PUSH)) != other.nearest(PLACE, PUSH))


def test_a_kept_table_is_the_one_that_was_made(rig, tmp_path):
    made = guess_table(rig, 2, False, size=60, folder=tmp_path)
    (file,) = tmp_path.iterdir()
    changed = file.stat().st_mtime_ns
    kept = guess_table(rig, 2, False, size=60, folder=tmp_path)
    assert file.stat().st_mtime_ns == changed
    for name in ("coefficients", "position", "force"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(made, name))
    guess_table(rig, 3, False, size=60, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 2  # another family, another file


@pytest.mark.parametrize("fault", ["empty", "text", "cut", "foreign", "pickle", "nan", "folder"])
def test_a_damaged_file_is_made_anew(rig, tmp_path, fault):
    good = guess_table(rig, 2, False, size=60, folder=tmp_path)
    (file,) = tmp_path.iterdir()
    content = file.read_bytes()
    with np.load(file) as data:
        parts = dict(data)
    if fault == "empty":
        file.write_bytes(b"")
    elif fault == "text":
        file.write_text("not a table")
    elif fault == "cut":
        file.write_bytes(content[: len(content) // 2])
    elif fault == "foreign":
        np.savez(file, **(parts | {"mark": "another version"}))
    elif fault == "pickle":
        np.savez(file, **(parts | {"force": np.array([{}, {}], dtype=object)}))
    elif fault == "nan":
        np.savez(file, **(parts | {"force": parts["force"] * np.nan}))
    else:
        file.unlink()
        file.mkdir()
    again = guess_table(rig, 2, False, size=60, folder=tmp_path)
    np.testing.assert_array_equal(again.force, good.force)
    if fault != "folder":
        assert file.read_bytes() == content or guess_table(
            rig, 2, False, size=60, folder=tmp_path
        ).force.shape == (60, 2)
        assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_where_nothing_can_be_written_nothing_is_kept(rig, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert guess_table(rig, 2, False, size=60, folder=blocked / "folder").force.shape == (60, 2)


def test_the_folder_is_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "plate_solver"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home/.cache/plate_solver"
