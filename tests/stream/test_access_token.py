"""The secret word of a client that has no key."""

from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.errors import ConfigError
from labdaemon.stream.access_token import LONGEST, SHORTEST, AccessToken

TOKEN = "0123456789abcdef"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_text(TOKEN + "\n")
    path.chmod(0o600)
    return path


def test_the_first_line_is_the_token(file: Path) -> None:
    file.write_text(f"  {TOKEN}  \nanother line\n")
    token = AccessToken(file, "web.token_file")
    assert token.matches(TOKEN)
    for wrong in ("", TOKEN[:-1], TOKEN + "0", TOKEN.upper(), "another line", "Ä" * 16, "\ud800"):
        assert not token.matches(wrong)


def test_it_is_never_shown(file: Path) -> None:
    token = AccessToken(file, "web.token_file")
    assert TOKEN not in repr(token)
    assert TOKEN not in f"{token}"


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o666, 0o601])
def test_a_file_that_others_can_read_is_refused(file: Path, mode: int) -> None:
    file.chmod(mode)
    with pytest.raises(ConfigError, match="chmod 600") as caught:
        AccessToken(file, "web.token_file")
    assert caught.value.key == "web.token_file"
    assert TOKEN not in str(caught.value)


@pytest.mark.parametrize("text", [
    "", "\n" + TOKEN, "x" * (SHORTEST - 1), "x" * (LONGEST + 1), "with a space inside", "ümläut-ümläut-ümläut",
    "\x00" * 20,
])  # fmt: skip
def test_what_is_no_token_is_refused_with_how_to_make_one(file: Path, text: str) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError, match="openssl rand"):
        AccessToken(file, "web.token_file")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        AccessToken(tmp_path / "token", "web.token_file")
