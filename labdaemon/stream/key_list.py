"""The list of client keys that get in: one line a key, ``role name public-key``, with comments after ``#``.

``name`` is who a key is called in messages and by ``labdaemon keys revoke``. A key may contain ``#`` itself, so only
what comes after the three words can be a comment.
"""

from __future__ import annotations

import re
import stat
from dataclasses import dataclass
from pathlib import Path

from labdaemon.durable import write_durably
from labdaemon.errors import ConfigError, UsageError
from labdaemon.stream.key_files import is_key
from labdaemon.stream.roles import Role
from labdaemon.tomlfile import read_text

HEAD = "# Clients of this daemon: role name public-key. A line that is removed ends that client's connections.\n"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")
MOST_CLIENTS = 1000


@dataclass(frozen=True, slots=True)
class ListedClient:
    """A client that gets in.

    Attributes
    ----------
    public
        Its public key, Z85.
    """

    name: str
    role: Role
    public: str


def parse_clients(text: str, source: Path | str | None = None) -> tuple[ListedClient, ...]:
    """The clients of a list.

    Raises
    ------
    ConfigError
        Names file and line: not three words, no role, no name, no key; a name or a key that was listed above.
    """
    clients: list[ListedClient] = []
    names: dict[str, int] = {}
    keys: dict[str, int] = {}
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        client = _client(words, source, number)
        for seen, value, what in ((names, client.name, "name"), (keys, client.public, "key")):
            if value in seen:
                message = (
                    f"this {what} is on line {seen[value]} already; each client has one name, one key and one role"
                )
                raise ConfigError(message, source=source, key=f"line {number}")
            seen[value] = number
        clients.append(client)
        if len(clients) > MOST_CLIENTS:
            raise ConfigError(f"more than {MOST_CLIENTS} clients", source=source, key=f"line {number}")
    return tuple(clients)


def _client(words: list[str], source: Path | str | None, number: int) -> ListedClient:
    place = f"line {number}"
    if len(words) < 3 or (len(words) > 3 and not words[3].startswith("#")):
        raise ConfigError("a line is: role name public-key", source=source, key=place)
    role, name, public = words[:3]
    if role not in set(Role):
        raise ConfigError(f"{role[:40]!r} is no role; write {' or '.join(Role)}", source=source, key=place)
    if not NAME.fullmatch(name):
        raise ConfigError(f"{name[:64]!r} is no name; use letters, digits and . _ @ -", source=source, key=place)
    if not is_key(public):
        raise ConfigError("is no public key of 40 Z85 characters; was it cut off?", source=source, key=place)
    return ListedClient(name, Role(role), public)


def read_clients(path: Path) -> tuple[ListedClient, ...]:
    """The clients of a list file; none where there is no file.

    Raises
    ------
    ConfigError
        As `parse_clients`; or it cannot be read, or everybody on the machine could add a key to it.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return ()
    except (OSError, ValueError) as exc:
        raise ConfigError(f"cannot be read ({getattr(exc, 'strerror', None) or exc})", source=path) from None
    if mode & stat.S_IWOTH:
        raise ConfigError(f"anyone on this machine can add a key to it; chmod o-w {path}", source=path)
    return parse_clients(read_text(path), path)


def add_client(path: Path, client: ListedClient) -> None:
    """Add a client at the end of the list.

    Raises
    ------
    UsageError
        The name cannot be one, or is taken.
    ConfigError, StorageError
        The list cannot be read or written.
    """
    if not NAME.fullmatch(client.name):
        raise UsageError(f"{client.name[:64]!r} is no name; use letters, digits and . _ @ -")
    if any(client.name == other.name for other in read_clients(path)):
        raise UsageError(f"{client.name} has a key already; revoke that one first, or take another name")
    text = read_text(path) if path.exists() else HEAD
    line = f"{client.role} {client.name} {client.public}\n"
    write_durably(path, text + ("" if text.endswith("\n") or not text else "\n") + line)


def remove_client(path: Path, name: str) -> ListedClient:
    """Take a client off the list, and return it. Comments and all other lines stay.

    Raises
    ------
    UsageError
        There is no such client; the message names those that there are.
    ConfigError, StorageError
        The list cannot be read or written.
    """
    clients = read_clients(path)
    found = next((client for client in clients if client.name == name), None)
    if found is None:
        names = ", ".join(client.name for client in clients)
        raise UsageError(f"no client is named {name[:64]!r}; listed are {names or 'none'}")
    lines = read_text(path).splitlines(keepends=True)
    write_durably(path, "".join(line for line in lines if line.split()[1:2] != [name] or line.lstrip()[:1] == "#"))
    return found
