"""Files are written whole or not at all, whatever stands at their path."""

from __future__ import annotations

import errno
import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from cadcam.errors import BadValue, UnwritableFile
from cadcam.whole import write_whole


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_new_file_replaces_the_old_one_and_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    write_whole(path, b"one")
    path.chmod(0o640)
    write_whole(path, b"two")
    assert path.read_bytes() == b"two"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert names(path.parent) == ["a.txt"]


def test_what_goes_wrong_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.txt"
    write_whole(path, b"one")

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(UnwritableFile, match="No space left on device; free some space"):
        write_whole(path, b"two")
    assert path.read_bytes() == b"one"
    assert names(tmp_path) == ["a.txt"]


def test_a_link_goes_on_naming_its_file(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    for name, old in (("kept.txt", b"old"), ("dangling.txt", None)):
        target, link = tmp_path / "there" / name, tmp_path / name
        if old is not None:
            target.write_bytes(old)
        link.symlink_to(target)
        write_whole(link, b"new")
        assert link.is_symlink()
        assert target.read_bytes() == b"new"
    assert names(tmp_path / "there") == ["dangling.txt", "kept.txt"]


def test_a_pipe_takes_the_bytes_and_stays_a_pipe(tmp_path: Path) -> None:
    """As /dev/stdout and /dev/null do, which a superuser could replace by a file."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()), daemon=True)
    reader.start()
    write_whole(pipe, b"bytes")
    reader.join(timeout=10)
    assert read == [b"bytes"]
    assert pipe.is_fifo()


def test_the_longest_name_that_a_folder_takes_can_be_written(tmp_path: Path) -> None:
    write_whole(tmp_path / ("n" * 255), b"data")
    assert names(tmp_path) == ["n" * 255]


@pytest.mark.parametrize(("name", "words"), [("folder", "is a folder"), ("a\0b", "null"), ("n" * 256, "too long")])
def test_names_that_cannot_be_files_are_refused(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(UnwritableFile, match=words):
        write_whole(tmp_path / name, b"data")
    assert names(tmp_path) == ["folder"]


def watched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list of what is done from now on: names of what is synced, and replacements."""
    done: list[str] = []
    sync, replace = os.fsync, os.replace

    def kind(handle: int) -> str:
        return "folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file"

    monkeypatch.setattr(os, "fsync", lambda handle: (done.append(kind(handle)), sync(handle))[1])
    monkeypatch.setattr(os, "replace", lambda a, b: (done.append("replace"), replace(a, b))[1])
    return done


def test_the_bytes_are_on_the_disk_before_the_name_is_and_the_name_before_it_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a power cut may leave the new name of an empty file in place of the old file."""
    done = watched(monkeypatch)
    write_whole(tmp_path / "a.txt", b"one")
    assert done == ["file", "replace", "folder"]
    done.clear()
    write_whole(tmp_path / "a.txt", b"two", durable=False)
    assert done == ["replace"]


def test_bytes_that_the_disk_did_not_take_replace_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Delayed writes fail when they are waited for; a file system that cannot be asked is taken as it is."""
    path = tmp_path / "a.txt"
    write_whole(path, b"one")

    def failing(number: int) -> None:
        def fail(_: int) -> None:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "fsync", fail)

    failing(errno.EIO)
    with pytest.raises(UnwritableFile, match=os.strerror(errno.EIO)):
        write_whole(path, b"two")
    assert path.read_bytes() == b"one"
    assert names(tmp_path) == ["a.txt"]
    failing(errno.EINVAL)
    write_whole(path, b"two")
    assert path.read_bytes() == b"two"


def test_pieces_are_written_as_they_come_and_whole_or_not_at_all(tmp_path: Path) -> None:
    """The old file stays until the last piece is there; one that cannot be had leaves it, and no other name."""
    path = tmp_path / "new" / "a.txt"

    def pieces(last: bytes) -> Iterator[bytes]:
        yield b"one, "
        yield b"two, "
        assert [p.stat().st_size for p in path.parent.iterdir() if p != path] == [10]
        if not last:
            raise BadValue("the last piece", "missing", "three")
        yield last

    write_whole(path, pieces(b"three"))
    assert path.read_bytes() == b"one, two, three"
    with pytest.raises(BadValue, match="the last piece is missing"):
        write_whole(path, pieces(b""))
    assert path.read_bytes() == b"one, two, three"
    assert names(path.parent) == ["a.txt"]
