"""The secret word of a client that has no key, from a file that only its owner can read."""

from __future__ import annotations

import hmac
import os
import stat
from pathlib import Path

from labdaemon.errors import ConfigError

SHORTEST = 16  # below this a token can be guessed over a network in a night
LONGEST = 200  # fits into one header line


class AccessToken:
    """A token as the rig file names it.

    Parameters
    ----------
    path
        The file; its first line is the token.
    key
        Of the rig file, for the message.

    Raises
    ------
    ConfigError
        It cannot be read, others than its owner can read it, or it is too short.
    """

    def __init__(self, path: Path, key: str) -> None:
        try:
            with path.open("rb") as file:
                mode = os.fstat(file.fileno()).st_mode
                line = file.read(4 * LONGEST).splitlines()[:1]
        except OSError as exc:
            raise ConfigError(f"{path} cannot be read: {exc.strerror}", key=key) from None
        if stat.S_IMODE(mode) & 0o077:
            raise ConfigError(f"{path} can be read by others; run: chmod 600 {path}", key=key)
        self._token = line[0].strip() if line else b""
        if not SHORTEST <= len(self._token) <= LONGEST or not all(0x20 < byte < 0x7F for byte in self._token):
            raise ConfigError(
                f"the first line of {path} is no token: {SHORTEST} to {LONGEST} printable ASCII characters, no spaces "
                "(make one with: openssl rand -hex 16)",
                key=key,
            )

    def matches(self, given: str) -> bool:
        """Whether a client's word is the token."""
        return hmac.compare_digest(self._token, given.encode("utf-8", "replace"))

    def __repr__(self) -> str:
        return "<AccessToken>"
