"""Key files: 0600, whole or absent, and refused in every state that a crash or a person can leave them in."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from zmq.utils import z85

from labdaemon.errors import ConfigError
from labdaemon.stream.access import OWN_KEY, own_pair
from labdaemon.stream.key_files import KeyPair, is_key, make_pair, pair_text, read_pair, write_secret


@pytest.fixture
def pair() -> KeyPair:
    return make_pair(make_pair().public)


@pytest.fixture
def written(tmp_path: Path, pair: KeyPair) -> Path:
    path = tmp_path / "olga.key"
    write_secret(path, pair_text(pair, name="olga", role="operator"))
    return path


def test_a_pair_comes_back(written: Path, pair: KeyPair) -> None:
    assert read_pair(written, is_client=True) == pair


def test_a_secret_is_its_owners_alone_whatever_the_umask(tmp_path: Path, pair: KeyPair) -> None:
    before = os.umask(0)
    try:
        write_secret(tmp_path / "a.key", pair_text(pair, name="a", role="observer"))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.key").stat().st_mode) == 0o600
    assert [path.name for path in tmp_path.iterdir()] == ["a.key"]


def test_a_secret_is_never_written_over(written: Path, pair: KeyPair) -> None:
    before = written.read_bytes()
    with pytest.raises(FileExistsError):
        write_secret(written, "other")
    assert written.read_bytes() == before


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o610, 0o666])
def test_a_secret_that_others_can_use_is_refused(written: Path, mode: int) -> None:
    written.chmod(mode)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_pair(written, is_client=True)


def test_half_a_file_is_no_key(written: Path) -> None:
    whole = written.read_bytes()
    for size in range(len(whole) - 1):  # the last byte is a line's end
        written.write_bytes(whole[:size])
        with pytest.raises(ConfigError, match=r"olga\.key"):
            read_pair(written, is_client=True)


@pytest.mark.parametrize(
    "content",
    [b"", b"\0" * 300, b"\xff\xfe", b"x" * 10_000, b"public = 7\nsecret = 8\n", b"[public]\n"],
    ids=["empty", "zeros", "binary", "long", "numbers", "table"],
)
def test_what_is_no_key_file_is_refused_in_one_line(written: Path, content: bytes) -> None:
    written.write_bytes(content)
    with pytest.raises(ConfigError) as refused:
        read_pair(written, is_client=True)
    assert "\n" not in str(refused.value)


def test_a_missing_file_a_folder_and_a_pipe_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe", 0o600)
    for path in (tmp_path / "none", tmp_path, tmp_path / "pipe", Path("a\0b")):
        with pytest.raises(ConfigError):
            read_pair(path, is_client=True)


def test_the_public_key_must_be_of_the_secret(tmp_path: Path, pair: KeyPair) -> None:
    mixed = KeyPair(make_pair().public, pair.secret, pair.daemon)
    write_secret(tmp_path / "a.key", pair_text(mixed, name="a", role="observer"))
    with pytest.raises(ConfigError, match="not the public key of this secret"):
        read_pair(tmp_path / "a.key", is_client=True)


def test_the_daemons_own_file_is_no_clients(tmp_path: Path) -> None:
    own_pair(tmp_path)
    with pytest.raises(ConfigError, match="daemon: is missing"):
        read_pair(tmp_path / OWN_KEY, is_client=True)


def test_the_daemons_key_is_made_once_however_many_need_it_first(tmp_path: Path) -> None:
    found: list[KeyPair] = []
    threads = [threading.Thread(target=lambda: found.append(own_pair(tmp_path))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({pair.secret for pair in found}) == 1
    assert len(found) == 8
    assert [path.name for path in tmp_path.iterdir()] == [OWN_KEY]


def test_a_secret_shows_in_no_message(pair: KeyPair) -> None:
    assert pair.secret not in repr(pair)
    assert pair.secret not in f"{pair}"


@given(st.binary(min_size=32, max_size=32))
def test_every_32_bytes_are_a_key(raw: bytes) -> None:
    assert is_key(z85.encode(raw).decode())


@pytest.mark.parametrize("text", ["", "a" * 39, "a" * 41, "#" * 40, "é" * 40, " " * 40, None, 7, "~" * 40])
def test_what_is_no_key(text: object) -> None:
    assert not is_key(text)
