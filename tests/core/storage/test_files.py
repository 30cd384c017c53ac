"""Only regular files up to a size are read, whatever lies under a name; text of files is shown and never obeyed."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.core.storage.files import open_file, read_file
from rotorid_torch.core.storage.memory import bounded_memory
from rotorid_torch.errors import InputError
from rotorid_torch.printable import printable


@pytest.fixture(autouse=True)
def _no_hanging() -> Iterator[None]:
    """What blocks is ended by a signal, and fails."""

    def fail(number: int, frame: object) -> None:
        raise AssertionError("it hangs")

    earlier = signal.signal(signal.SIGALRM, fail)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, earlier)


def special(kind: str, place: Path) -> str:
    """Something that is no regular file at this place, and the word that tells it."""
    if kind == "pipe":
        os.mkfifo(place)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(str(place))
        return "cannot be read"
    elif kind == "folder":
        place.mkdir()
    elif kind == "dangling link":
        place.symlink_to(place.parent / "nowhere")
        return "no such file"
    elif kind == "loop of links":
        place.symlink_to(place)
        return "cannot be read"
    else:
        place.symlink_to("/dev/zero")
    return kind


KINDS = ("pipe", "socket", "folder", "device", "dangling link", "loop of links")


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file_is_told(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    word = special(kind, Path("x"))
    for read in (open_file, read_file):
        with pytest.raises(InputError, match=rf"^x: .*{word}.*expected a map"):
            read(Path("x"), "a map", 100)


def test_sizes_are_judged(tmp_path: Path):
    file = tmp_path / "x"
    file.write_bytes(b"abc")
    assert read_file(file, "a map", 3) == b"abc"
    with open_file(file, "a map", 3) as stream:
        assert stream.read() == b"abc"
    for read in (open_file, read_file):
        with pytest.raises(InputError, match="has 3 bytes; expected a map, of at most 2 bytes"):
            read(file, "a map", 2)
    with file.open("wb") as sparse:
        sparse.truncate(2**42)
    with pytest.raises(InputError, match="has 4398046511104 bytes"):
        open_file(file, "a log")


def test_files_that_tell_no_size(tmp_path: Path):
    with pytest.raises(InputError, match="has over 10 bytes"):
        read_file("/proc/self/maps", "a map", 10)
    with pytest.raises(InputError, match="cannot be read"):
        read_file("a\0b", "a map", 10)


def test_no_descriptor_is_left_open(tmp_path: Path):
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        with pytest.raises(InputError):
            open_file(tmp_path, "a map")
    assert len(os.listdir("/proc/self/fd")) == before


def test_memory_is_bounded_for_a_while():
    with pytest.raises(MemoryError), bounded_memory(2**27):
        bytearray(2**29)
    assert len(bytearray(2**29)) == 2**29


@given(st.text())
def test_what_is_printable_has_no_controls_and_stays_so(text: str):
    shown = printable(text, layout=False)
    assert len(shown) == len(text)
    assert printable(shown, layout=False) == shown
    assert not {*shown} & {*map(chr, (*range(0x20), *range(0x7F, 0xA0))), "\u2028", "\u202e", "\ud800"}
    shown.encode()


def test_what_people_write_stays_as_it_is():
    text = "Ümläute, 日本語, 1 m/s² ± 3 % – “q̇” [red]\n\tx"
    assert printable(text) == text
    assert printable("\x1b[31m\x07\x9b2J") == "␛[31m␇�2J"
