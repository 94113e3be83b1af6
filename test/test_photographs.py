"""The photographs: their list, how they are fetched, and how detectors are judged on them."""

import hashlib

import cv2
import numpy as np
import pytest
from photographs import evaluate, fetch, finders, pictures, taught
from photographs.finders import FINDING
from photographs.pictures import HALVES, TRUTH, Photograph, load_photographs

LICENCES = {
    "Apache-2.0", "BSD-3-Clause", "CC-BY-4.0", "CC0-1.0", "GPL-3.0", "LGPL-2.1", "MIT",
}  # fmt: skip


def photograph(parts=(), ignore=(), plate=None, **of):
    given = {
        "name": "discs", "half": "tuning", "licence": "MIT", "by": "us", "sha256": "0",
        "source": {"github": "a/b", "commit": "c", "path": "d.png"}, "crop_px": None, "shrink": 1,
    }  # fmt: skip
    return Photograph(
        **{**given, **of},
        parts=np.array(list(parts), TRUTH),
        ignore=np.array(list(ignore), float).reshape(-1, 3),
        plate=plate,
    )


def found(*rows):
    return np.array([(*row, np.nan, "") if len(row) == 3 else row for row in rows], FINDING)


def disc(x, y, radius, label="disc", touching=False):
    return (x, y, radius, np.nan, 0, label, touching)


def test_the_list_of_photographs_is_complete():
    listed = load_photographs()
    assert len({p.name for p in listed}) == len(listed) >= 30
    for p in listed:
        digest = hashlib.sha256(p.name.encode()).digest()
        assert p.half == HALVES[digest[0] % 2], p.name
        assert p.licence in LICENCES, p.name
        assert len(p.sha256) == 64
        assert "package" in p.source or len(p.source["commit"]) == 40
        assert len(p.parts), p.name
        assert np.all(p.parts["radius_px"] > 1)
        assert np.array_equal(np.isfinite(p.parts["angle_deg"]), p.parts["symmetry"] > 0), p.name


def test_no_part_is_marked_twice_and_none_is_ignored():
    for p in load_photographs():
        centre = np.stack([p.parts["x_px"], p.parts["y_px"]], axis=1)
        gap = np.linalg.norm(centre[:, None] - centre, axis=2) + 1e9 * np.eye(len(centre))
        assert np.all(gap > 0.5 * p.parts["radius_px"]), p.name
        assert evaluate.counts(as_found(p.parts), p).all(), p.name


def as_found(parts):
    rows = np.zeros(len(parts), FINDING)
    for name in FINDING.names:
        rows[name] = parts[name]
    return rows


def test_a_detector_that_is_right_gets_full_marks():
    for p in load_photographs():
        score = evaluate.score(as_found(p.parts), p)
        assert score["hit"] == score["true"] == score["right"] == [True] * len(p.parts)
        assert max(score["centre_px"]) == 0
        assert not np.any(score["angle_deg"])


def test_found_is_one_to_one_and_within_half_a_radius():
    truth = photograph([disc(50, 50, 10), disc(80, 50, 10)])
    score = evaluate.score(found((54.9, 50, 10), (50, 50, 3), (85.1, 50, 10)), truth)
    assert score["hit"] == [True, False]
    assert score["true"] == [True, False, False]
    assert score["centre_px"] == [0]


def test_detections_in_ignored_areas_or_off_the_plate_do_not_count():
    corners = np.array([(0, 0), (100, 0), (100, 100), (0, 100)], float)
    truth = photograph([disc(50, 50, 10)], [(20, 20, 10)], corners)
    cases = {(22, 20, 11): 0, (22, 20, 1): 1, (150, 50, 10): 0, (80, 80, 10): 1}
    for one, false in cases.items():
        assert evaluate.score(found(one), truth)["true"].count(False) == false, one


@pytest.mark.parametrize(
    ("symmetry", "directed", "turned", "error"),
    [(2, False, 180, 0), (1, False, 180, 0), (1, True, 170, 85), (4, True, 90, 0), (2, True, 8, 4)],
)
def test_angles_are_judged_modulo_symmetry_and_a_common_zero(symmetry, directed, turned, error):
    parts = np.array([(0, 0, 5, angle, symmetry, "a", False) for angle in (10, 40)], TRUTH)
    seen = found((0, 0, 5, 37.0, ""), (0, 0, 5, 67.0 + turned, ""))
    errors = evaluate.angle_errors(seen, parts, directed)
    assert errors == pytest.approx([error, error], abs=1e-9)


def test_parts_that_were_shown_are_not_counted_as_fresh():
    truth = photograph([disc(50, 50, 10), disc(80, 50, 10)])
    score = evaluate.score(found((50, 50, 10)), truth, np.array([True, False]))
    assert (score["hit"], score["fresh"]) == ([True, False], [False])


@pytest.fixture(name="folder")
def _folder(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "FOLDER", tmp_path)
    return tmp_path


def test_a_file_with_another_checksum_is_not_kept(folder, monkeypatch):
    monkeypatch.setattr(fetch, "_read_photograph", lambda photograph: b"other")
    expected = photograph(sha256="0" * 64)
    assert fetch.fetch_photograph(expected).startswith("sha256 is d9298a10")
    assert not list(folder.iterdir())
    right = photograph(sha256=hashlib.sha256(b"other").hexdigest())
    assert fetch.fetch_photograph(right) == ""
    assert fetch.is_there(right)


def test_without_a_network_missing_files_are_reported_and_the_rest_continues(
    folder, monkeypatch, capsys
):
    def no_network(photograph):
        raise OSError("no\nnetwork")

    monkeypatch.setattr(fetch, "_read_photograph", no_network)
    monkeypatch.setattr(fetch, "load_photographs", lambda: [photograph(), photograph()])
    monkeypatch.setattr("sys.argv", ["fetch"])
    assert fetch.main() == 0
    output = capsys.readouterr()
    assert output.err.splitlines() == ["missing: discs: no network"] * 2
    assert output.out.startswith("0 of 2 photographs ")


DISCS = [disc(40, 40, 12), disc(90, 50, 15), disc(60, 100, 10), disc(79, 100, 10, touching=True)]


@pytest.fixture(name="taken")
def _taken(folder):
    """A picture of red discs on grey, two of them touching, twice as large as is used of it."""
    image = np.full((150, 160, 3), 120, np.uint8)
    for x, y, radius, *_ in DISCS:
        cv2.circle(image, (x, y), radius, (40, 40, 200), cv2.FILLED)
    wide = np.pad(image, ((0, 0), (7, 0), (0, 0)), mode="edge")
    large = cv2.resize(wide, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    taken = photograph(DISCS, crop_px=(14, 0, 320, 300), shrink=2)
    taken.file.parent.mkdir()
    cv2.imwrite(str(taken.file), large)
    assert np.array_equal(taken.image(), image)
    return taken


@pytest.mark.needs("skimage")
def test_the_peer_finds_discs(taken):
    score = evaluate.score(finders.watershed(taken.image()), taken)
    assert sum(score["hit"]) == 4
    assert max(score["centre_px"]) < 2


def test_rows_of_an_evaluation(taken, monkeypatch):
    only = {"half": lambda image: as_found(taken.parts[:2])}
    monkeypatch.setattr(evaluate, "make_finders", lambda: dict(only))
    shown = np.array([True, False, False, False])
    lesson = (lambda image: as_found(taken.parts[:3]), shown, ["disc: too round"])
    monkeypatch.setattr(evaluate, "teach_examples", lambda image, parts: lesson)
    rows, refused = evaluate.evaluate([taken])
    assert [(row["method"], row["parts"], row["pictures"]) for row in rows] == [
        ("half", 4, 1),
        (evaluate.TAUGHT, 4, 1),
    ]
    assert [row["recall"] for row in rows] == [50, 75]
    assert rows[1]["fresh"] == pytest.approx(200 / 3)
    assert rows[1]["right"] == 100
    assert refused == ["discs: disc: too round"]


def test_taught_discs_are_found_and_named(taken):
    image, alone = taken.image(), taken.parts[~taken.parts["touching"]]
    find, shown, _ = taught.teach_examples(image, alone[:2])
    assert shown.all()
    score = evaluate.score(find(image), taken)
    assert sum(score["hit"]) >= 2
    assert score["right"] == [True] * sum(score["hit"])
