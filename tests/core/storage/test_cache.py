"""What is kept comes back as it was written or not at all; the cache stays small, and holds nothing of others'."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from rotorid_torch.core.storage import cache

LIBRARY, OTHER, DRAW = f"{'a' * 24}.so", f"{'b' * 24}.so", f"draws/{'c' * 24}/3.json"
OLD_DRAW = DRAW.replace("draws", "floors")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "native"


def test_what_is_kept_comes_back(folder: Path):
    for name, content in ((LIBRARY, b"\x7fELF\0"), (DRAW, b"{}"), (OTHER, b"")):
        assert cache.read(name) is None
        cache.keep(name, content)
        assert cache.read(name) == content
        assert (folder / name).stat().st_mode & 0o777 == 0o600
    cache.discard(DRAW)
    assert cache.read(DRAW) is None


def test_any_byte_that_changes_and_any_cut_is_noticed(folder: Path):
    cache.keep(LIBRARY, b"one double: 0.125")
    whole = (folder / LIBRARY).read_bytes()
    for place in range(len(whole)):
        for damaged in (whole[:place], whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :]):
            (folder / LIBRARY).write_bytes(damaged)
            assert cache.read(LIBRARY) is None


@pytest.mark.parametrize("target", ["whole", "nowhere"])
def test_a_link_is_not_followed_and_gives_way(folder: Path, target: str, caplog: pytest.LogCaptureFixture):
    cache.keep(LIBRARY, b"content")
    (folder / LIBRARY).rename(folder.parent / "whole")
    (folder / LIBRARY).symlink_to(folder.parent / target)
    assert cache.read(LIBRARY) is None
    assert "a kept file is a link" in caplog.text
    cache.keep(LIBRARY, b"new")
    assert cache.read(LIBRARY) == b"new"
    assert not (folder / LIBRARY).is_symlink()


def test_a_whole_file_under_another_name_is_not_used(folder: Path):
    cache.keep(LIBRARY, b"content")
    (folder / LIBRARY).rename(folder / OTHER)
    assert cache.read(OTHER) is None


def test_what_is_too_large_is_not_read(folder: Path, caplog: pytest.LogCaptureFixture):
    folder.mkdir(parents=True)
    with (folder / LIBRARY).open("wb") as file:
        file.truncate(2**40)
    (folder / LIBRARY).chmod(0o600)
    assert cache.read(LIBRARY) is None
    assert "is too large" in caplog.text


def test_what_was_used_longest_ago_goes_first(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cache, "MOST", 2500)
    for name, days in ((LIBRARY, 3.0), (OTHER, 2.0)):
        cache.keep(name, bytes(1000))
        os.utime(folder / name, (0.0, time.time() - 86400.0 * days))
    cache.read(LIBRARY)
    cache.keep(DRAW, bytes(1000))
    assert cache.read(LIBRARY) is not None
    assert cache.read(DRAW) is not None
    assert cache.read(OTHER) is None


def test_what_nobody_has_used_for_long_goes(folder: Path):
    for name in (LIBRARY, OLD_DRAW):
        cache.keep(name, b"old")
        os.utime(folder / name, (0.0, time.time() - 86400.0 * (cache.DAYS + 1.0)))
    cache.keep(OTHER, b"new")
    assert [file.name for file in folder.rglob("*") if file.is_file()] == [OTHER]


def test_emptied_it_holds_only_what_is_not_ours(folder: Path):
    cache.keep(LIBRARY, bytes(100))
    cache.keep(DRAW, bytes(100))
    dead = folder / ".x.so.rotorid-01234567.partial"
    dead.touch()
    before = cache.usage()
    assert (before.folder, before.files) == (str(folder), 2)
    assert before.bytes == sum((folder / name).stat().st_size for name in (LIBRARY, DRAW))
    for name in ("mine.so", "thesis.txt", f"draws/{'c' * 24}/notes.json"):
        (folder / name).write_text("mine")
    assert cache.empty() == before
    assert cache.usage() == cache.Usage(str(folder), 0, 0)
    kept = sorted(file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file())
    assert kept == [f"draws/{'c' * 24}/notes.json", "mine.so", "thesis.txt"]


def test_emptied_nothing_is_left(folder: Path):
    for name in (LIBRARY, DRAW, OLD_DRAW):
        cache.keep(name, bytes(100))
    cache.empty()
    assert not folder.exists()
    assert cache.empty() == cache.Usage(str(folder), 0, 0)
