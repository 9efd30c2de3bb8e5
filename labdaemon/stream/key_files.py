"""Files with CURVE keys: written so that only their owner can read them, and refused when others can.

A key is 40 characters of Z85, as ZeroMQ's own tools write it. A secret file is TOML: ``public`` and ``secret``, and in
a client's file also its ``name``, its ``role`` and ``daemon``, the public key that the daemon must prove to have.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any

import zmq
from zmq.utils import z85

from labdaemon.durable import PART, make_folder, storage_error, sync_folder
from labdaemon.errors import ConfigError
from labdaemon.tomlfile import parse_toml

KEY_CHARACTERS = 40
Z85 = z85.Z85CHARS.decode()
MAX_BYTES = 4096
"""A key file has some hundred."""
OTHERS = stat.S_IRWXG | stat.S_IRWXO


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public key and its secret, Z85.

    Attributes
    ----------
    daemon
        The daemon's public key, in a client's file; None in the daemon's own.
    """

    public: str
    secret: str
    daemon: str | None = None

    def __repr__(self) -> str:
        return f"KeyPair(public={self.public!r})"  # a secret in a log or a traceback is one no more


def make_pair(daemon: str | None = None) -> KeyPair:
    """A new pair."""
    public, secret = zmq.curve_keypair()
    return KeyPair(public.decode(), secret.decode(), daemon)


def is_key(text: object) -> bool:
    """Whether a text is a key as far as can be seen: 40 characters of Z85."""
    if not isinstance(text, str) or len(text) != KEY_CHARACTERS or any(one not in Z85 for one in text):
        return False
    # Five characters can say more than the four bytes that they stand for.
    return all(
        sum(Z85.index(one) * 85 ** (4 - at) for at, one in enumerate(text[start : start + 5])) < 1 << 32
        for start in range(0, KEY_CHARACTERS, 5)
    )


def write_secret(path: Path, content: str) -> None:
    """Write a new file that its owner alone can read; it is there whole or not at all.

    Raises
    ------
    FileExistsError
        There is such a file; it was left alone.
    StorageError
        It cannot be written.
    """
    make_folder(path.parent)
    part = path.with_name(f".{path.name}.{token_hex(8)}.{os.getpid()}{PART}")
    try:
        descriptor = os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, stat.S_IRUSR | stat.S_IWUSR)
        try:
            with open(descriptor, "wb") as file:
                file.write(content.encode())
                file.flush()
                os.fsync(file.fileno())
            _give_name(part, path)
        finally:
            with suppress(FileNotFoundError):
                part.unlink()
        sync_folder(path.parent)
    except FileExistsError:
        raise
    except OSError as exc:
        raise storage_error(exc, path) from exc


def _give_name(part: Path, path: Path) -> None:
    """Rename, but never over another file: two processes may make the same key at once."""
    try:
        os.link(part, path)
    except PermissionError:  # a file system that knows no links
        if path.exists():
            raise FileExistsError(path) from None
        part.rename(path)


def read_secret(path: Path) -> dict[str, Any]:
    """Content of a secret file.

    Raises
    ------
    ConfigError
        Missing, empty, no TOML, or others than its owner can read it.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as exc:
        raise ConfigError(f"cannot be read ({getattr(exc, 'strerror', None) or exc})", source=path) from None
    status = os.fstat(descriptor)  # of the file that is read, whatever takes its name meanwhile
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise ConfigError("is no file", source=path)
    with open(descriptor, "rb") as file:
        if status.st_mode & OTHERS:
            raise ConfigError(
                f"others than its owner can use this secret (mode {stat.S_IMODE(status.st_mode):04o}); make new keys, "
                f"or if you are sure that it was not read: chmod 600 {path}",
                source=path,
            )
        raw = file.read(MAX_BYTES + 1)
    if not raw.strip(b"\0 \t\r\n"):
        raise ConfigError("is empty; remove it and make new keys", source=path)
    if len(raw) > MAX_BYTES:
        raise ConfigError("is no key file (too large)", source=path)
    try:
        return parse_toml(raw.decode(), source=path)
    except UnicodeDecodeError:
        raise ConfigError("is no key file (not UTF-8 text)", source=path) from None


def read_pair(path: Path, *, is_client: bool) -> KeyPair:
    """A key pair from its file.

    Parameters
    ----------
    is_client
        Whether the daemon's public key must be in it.

    Raises
    ------
    ConfigError
        As `read_secret`; or a key is missing, cut off, or not of this pair.
    """
    content = read_secret(path)
    for name in ("public", "secret", *(("daemon",) if is_client else ())):
        if not is_key(content.get(name)):
            word = "is missing" if name not in content else "is no key of 40 Z85 characters"
            raise ConfigError(f"{word}: the file is cut off or no key file", source=path, key=name)
    if zmq.curve_public(content["secret"].encode()).decode() != content["public"]:
        raise ConfigError("is not the public key of this secret; make new keys", source=path, key="public")
    return KeyPair(content["public"], content["secret"], content["daemon"] if is_client else None)


def pair_text(pair: KeyPair, *, name: str | None = None, role: str | None = None) -> str:
    """What a secret file says."""
    if pair.daemon is None:
        head = "# The daemon's own key. Whoever reads this file can pass for the daemon.\n"
    else:
        head = f'# Key of a labdaemon client. Whoever reads this file is {name}.\nname = "{name}"\nrole = "{role}"\n'
    keys = [("public", pair.public), ("secret", pair.secret), ("daemon", pair.daemon)]
    return head + "".join(f'{key} = "{value}"\n' for key, value in keys if value is not None)
