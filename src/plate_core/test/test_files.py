"""Files that a user names: odd ones are refused at once, whatever reads them."""

import contextlib
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from plate_core import PlateError, RigError, load_rig
from plate_core.files import OwnFile, check_file, draft, read_file

MOST = 1_000_000
ALLOWED = "allowed: a regular file up to 1 MB"


def fifo(path: Path) -> Path:
    os.mkfifo(path)
    return path


def sparse(path: Path) -> Path:
    with path.open("wb") as file:
        file.truncate(10**9)
    return path


def folder(path: Path) -> Path:
    path.mkdir()
    return path


def bound(path: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))  # a long path has no room in an address
    return path


def link(path: Path) -> Path:
    path.symlink_to(fifo(path.with_name("other")))
    return path


def loop(path: Path) -> Path:
    path.symlink_to(path)
    return path


ODD = {
    "fifo": (fifo, "is a FIFO"),
    "zero": (lambda path: Path("/dev/zero"), "is a device"),
    "sparse": (sparse, "has 1000 MB"),
    "folder": (folder, "is a folder"),
    "socket": (bound, "is a socket"),
    "link": (link, "is a FIFO"),
}


@pytest.mark.parametrize("kind", ODD)
def test_odd_files_are_refused_by_path_kind_and_what_is_allowed(tmp_path, kind):
    make, is_what = ODD[kind]
    path = make(tmp_path / "some.yaml")
    for look in (read_file, check_file):
        with pytest.raises(RigError) as caught:
            look(path, MOST, RigError)
        assert str(caught.value) == f"{path}: {is_what}, {ALLOWED}"


def test_files_of_unknown_size_are_read_up_to_the_maximum(tmp_path):
    path = Path("/proc/self/status")
    assert path.stat().st_size == 0
    assert read_file(path, MOST).startswith(b"Name:")
    with pytest.raises(PlateError, match=r"status: .*unlimited, allowed: .* up to 1e-05 MB"):
        read_file(path, 10)


def test_regular_files_and_links_to_them_are_read(tmp_path):
    path, alias = tmp_path / "some", tmp_path / "alias"
    alias.symlink_to(path)
    for content in (b"", b"a\0\r\n\xff", bytes(MOST)):
        path.write_bytes(content)
        assert read_file(path, MOST) == read_file(str(alias), MOST) == content
        check_file(alias, MOST)
    with pytest.raises(PlateError, match=r"some: has 1 MB, allowed: a regular file up to 0\.9"):
        read_file(path, 999_999)
    path.unlink()
    with pytest.raises(PlateError, match="alias: no such file"):
        read_file(alias, MOST)


def test_a_file_that_becomes_a_fifo_before_it_is_opened_is_refused_at_once(tmp_path, monkeypatch):
    path, opened = tmp_path / "some", os.open
    path.write_bytes(b"")

    def late(name, flags):
        path.unlink()
        os.mkfifo(path)
        return opened(name, flags)

    monkeypatch.setattr(os, "open", late)
    with pytest.raises(PlateError, match="some: is a FIFO"):
        read_file(path, MOST)


@pytest.mark.parametrize("kind", ["fifo", "sparse", "folder"])
def test_a_rig_file_is_one_of_them(tmp_path, kind):
    make, is_what = ODD[kind]
    with pytest.raises(RigError, match=is_what):
        load_rig(make(tmp_path / "rig.yaml"))


def test_two_processes_do_not_write_one_file(tmp_path):
    """Also after the file was replaced: each has a lock of its own."""
    path = tmp_path / "rows.json"
    with OwnFile(path) as file:
        for text in ("", "1", "2"):
            if text:
                file.write(text)
            with pytest.raises(PlateError, match=r"rows.json is in use, .* another file"):
                OwnFile(path)
            assert not text or path.read_text() == text
    with OwnFile(path) as file:
        assert path.read_text() == "2"
        file.write("3")
    assert path.read_text() == "3"
    assert [one.name for one in tmp_path.iterdir()] == ["rows.json"]


@pytest.mark.parametrize("link", [False, True])
def test_a_new_file_appears_with_its_content(tmp_path, link):
    """So that a killed process leaves no empty file."""
    path = tmp_path / "rows.json"
    if link:
        path.symlink_to(tmp_path / "far.json")
    with OwnFile(path):
        assert not path.exists()
    assert not (tmp_path / "far.json").exists()
    path.touch()
    with OwnFile(path):
        pass
    assert path.exists()


def test_a_file_that_another_process_has_filled_stays(tmp_path, monkeypatch):
    """Between the two steps in which it is examined and opened."""
    path = tmp_path / "rows.json"
    path.write_text("1")
    found = [False, True]
    monkeypatch.setattr(os.path, "lexists", lambda path: found.pop(0))
    with OwnFile(path) as file:
        assert path.read_text() == "1"
        file.write("2")
    assert path.read_text() == "2"


def test_a_new_file_that_a_process_without_a_lock_has_made_stays(tmp_path):
    """For example, that process runs on another computer."""
    path = tmp_path / "rows.json"
    with OwnFile(path) as file:
        path.write_text("1")
        with pytest.raises(PlateError, match=r"rows.json is in use"):
            file.write("2")
    assert path.read_text() == "1"


def test_a_folder_that_cannot_be_written_is_refused_before_the_first_write(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("plate_core.files._create", refuse)
    with pytest.raises(PermissionError, match=r"rows.json.draft"):
        OwnFile(tmp_path / "rows.json")
    assert not list(tmp_path.iterdir())


def test_an_own_file_that_is_a_link_remains_a_link(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "near.json").symlink_to(tmp_path / "far" / "rows.json")
    with OwnFile(tmp_path / "near.json") as file:
        file.write("1")
        with pytest.raises(PlateError, match="is in use"):
            OwnFile(tmp_path / "far" / "rows.json")
    assert (tmp_path / "near.json").is_symlink()
    assert (tmp_path / "far" / "rows.json").read_text() == "1"


def test_an_own_file_of_the_system_is_written_directly(tmp_path):
    """The shell's `> FILE` makes /dev/stdout a regular file, which stays the same."""
    path = tmp_path / "out"
    with path.open("w") as stdout:
        before = path.stat().st_ino
        with OwnFile(f"/proc/self/fd/{stdout.fileno()}") as file:
            file.write("1")
    assert (path.read_text(), path.stat().st_ino) == ("1", before)
    with OwnFile("/dev/null") as file, OwnFile("/dev/null") as again:
        file.write("1")
        again.write("2")


def test_a_written_file_keeps_its_permissions(tmp_path):
    path = tmp_path / "rows.json"
    path.touch(0o600)
    with OwnFile(path) as file:
        file.write("1")
    assert path.stat().st_mode & 0o777 == 0o600
    with draft(path, "rows") as file:
        file.write(b"2")
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("2", 0o600)


def test_a_full_disk_is_named_with_the_file(tmp_path):
    """A process whose files may have 100 bytes stands for a full disk."""
    path = tmp_path / "rows.json"
    code = (
        "import resource, sys; from plate_core.files import OwnFile; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)); "
        "OwnFile(sys.argv[1]).write('a' * 200)"
    )
    words = [sys.executable, "-c", code, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stderr.endswith(f"File too large: '{path}'\n")
    assert not list(tmp_path.iterdir())


def test_a_write_that_fails_leaves_the_file_and_keeps_no_lock(tmp_path):
    path = tmp_path / "rows.json"
    with OwnFile(path) as file:
        file.write("1")
        with pytest.raises(UnicodeEncodeError):
            file.write("\ud800")
        assert path.read_text() == "1"
        with pytest.raises(PlateError, match="is in use"):
            OwnFile(path)
        file.write("2")
        with pytest.raises(UnicodeEncodeError):
            file.write("\ud800")
    OwnFile(path).close()
    assert [one.name for one in tmp_path.iterdir()] == ["rows.json"]
    assert path.read_text() == "2"


@pytest.mark.parametrize("kind", [fifo, "link"])
def test_a_link_or_fifo_with_the_name_of_a_temporary_file_is_removed(tmp_path, kind):
    """It is neither written nor waited for."""
    path, other = tmp_path / "rows.json", tmp_path / "other"
    other.write_text("kept")
    with OwnFile(path) as own, contextlib.ExitStack() as readers:
        for name in ("rows.json.draft", f".rows.json.{os.getpid()}"):
            if kind == "link":
                (tmp_path / name).symlink_to(other)
            else:
                # with a reader, so that the writer of the FIFO does not wait
                reader = os.open(kind(tmp_path / name), os.O_RDONLY | os.O_NONBLOCK)
                readers.callback(os.close, reader)
        own.write("1")
        assert path.is_file()  # a FIFO would block the next line
        assert path.read_text() == "1"
    with draft(path, "rows") as file:
        file.write(b"2")
    assert path.is_file()
    assert path.read_text() == "2"
    assert other.read_text() == "kept"


@pytest.mark.parametrize("kind", [fifo, folder, loop])
def test_an_own_file_of_another_kind_is_refused_at_once(tmp_path, kind):
    with pytest.raises(OSError, match=str(tmp_path)):
        OwnFile(kind(tmp_path / "rows.json"))
