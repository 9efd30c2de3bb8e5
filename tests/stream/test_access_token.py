"""Tokens: from a file of their owner, and nothing else matches."""

from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.errors import ConfigError
from labdaemon.stream.access_token import LONGEST, AccessToken

WORD = "0123456789abcdef"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_text(WORD + "\r\nsecond line\n")
    path.chmod(0o600)
    return path


def test_the_first_line_matches_and_nothing_else(file: Path):
    token = AccessToken(file, "web.token_file")
    assert token.matches(WORD)
    for word in ("", WORD[:-1], WORD + "0", WORD.upper() + "x", "\ud800", "é" * 16, "second line"):
        assert not token.matches(word)
    assert WORD not in repr(token)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o777])
def test_a_file_that_others_reach_is_refused_with_what_to_run(file: Path, mode: int):
    file.chmod(mode)
    with pytest.raises(ConfigError, match=r"web\.token_file: .* run: chmod 600"):
        AccessToken(file, "web.token_file")


@pytest.mark.parametrize("text", [b"", b"\n", b"short\n", b"with a space in it\n", b"x" * (LONGEST + 1), b"\xff" * 20])
def test_what_is_no_token_is_refused(file: Path, text: bytes):
    file.write_bytes(text)
    with pytest.raises(ConfigError, match="is no token"):
        AccessToken(file, "web.token_file")


def test_a_file_that_is_absent_or_a_folder_is_refused(tmp_path: Path):
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(ConfigError, match="cannot be read"):
            AccessToken(path, "web.token_file")
