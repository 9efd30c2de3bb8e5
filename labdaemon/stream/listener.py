"""Listening sockets: TCP, and Unix sockets whose file says who may connect."""

from __future__ import annotations

import errno
import grp
import os
import socket
import stat
from contextlib import suppress
from dataclasses import dataclass

from labdaemon.errors import ConfigError

TCP, IPC = "tcp://", "ipc://"
KEEPALIVE = {socket.TCP_KEEPIDLE: 30, socket.TCP_KEEPINTVL: 10, socket.TCP_KEEPCNT: 3}
"""Seconds and tries after which a computer that was switched off gives its place back; the system's are hours."""
GONE_S = 60
"""A computer that takes nothing of what is sent to it for so long has gone; the system tries for 15 minutes."""


@dataclass(frozen=True, slots=True)
class SocketFile:
    """Who may use a Unix socket.

    Attributes
    ----------
    mode
        Permissions of its file.
    group
        Name of the group that it belongs to; None for the daemon's own.
    """

    mode: int = 0o600
    group: str | None = None


def watch_peer(peer: socket.socket, *, is_written_to: bool = False) -> None:
    """Have the system end a TCP connection whose peer went without a word: switched off, or out of its network.

    Parameters
    ----------
    is_written_to
        Whether bytes wait for the peer most of the time, so that its silence alone never shows. Then one that is there
        and reads nothing for `GONE_S` loses its connection as well.

    Raises
    ------
    OSError
        It has left already.
    """
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in KEEPALIVE.items():
        peer.setsockopt(socket.IPPROTO_TCP, option, value)
    if is_written_to:
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, GONE_S * 1000)


def listen(address: str, backlog: int, place: SocketFile | None = None) -> tuple[socket.socket, str]:
    """A listening socket that does not block, and its address with the port that was taken.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT``, where ``*`` as host is every network and as port a free one, or ``ipc://PATH``.
    place
        Of a Unix socket's file; its owner alone may connect by default.

    Raises
    ------
    OSError
        The address is taken, or none of this machine's.
    ConfigError
        There is no such group.
    """
    if address.startswith(IPC):
        return _listen_at_path(address.removeprefix(IPC), backlog, place or SocketFile()), address
    host, _, port = address.removeprefix(TCP).rpartition(":")
    name = "0.0.0.0" if host == "*" else host.strip("[]")
    found = socket.getaddrinfo(name, None if port == "*" else int(port), type=socket.SOCK_STREAM)
    found.sort(key=lambda entry: entry[0] != socket.AF_INET)  # "localhost" is both; clients look for the older first
    family, kind, protocol, _, address_info = found[0]
    listener = socket.socket(family, kind | socket.SOCK_CLOEXEC, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listener.bind(address_info)
        listener.listen(backlog)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener, f"{TCP}{host}:{listener.getsockname()[1]}"


def stop_listening(listener: socket.socket, address: str) -> None:
    """Close it; the file of a Unix socket is removed unless another daemon has put its own there."""
    if address.startswith(IPC) and listener.fileno() >= 0:
        path = address.removeprefix(IPC)
        with suppress(OSError):
            if not _is_answered(path, listener):
                os.unlink(path)
    listener.close()


def _is_answered(path: str, own: socket.socket | None = None) -> bool:
    """Whether somebody listens there (who is not `own`, which is closed first)."""
    if own is not None:
        own.close()
    probe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        probe.settimeout(1.0)
        probe.connect(path)
    except (ConnectionRefusedError, FileNotFoundError):
        return False
    except OSError:
        return True
    finally:
        probe.close()
    return True


def _listen_at_path(path: str, backlog: int, place: SocketFile) -> socket.socket:
    """Made under another name, given its permissions, and only then put where clients look for it."""
    group = _group_id(place.group) if place.group is not None else -1
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise OSError(errno.EEXIST, "another file is there")
    if _is_answered(path):
        raise OSError(errno.EADDRINUSE, "another program listens there")
    unready = f"{path}.{os.getpid()}"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        with suppress(FileNotFoundError):
            os.unlink(unready)
        listener.bind(unready)
        os.chown(unready, -1, group)
        os.chmod(unready, place.mode)
        listener.listen(backlog)
        listener.setblocking(False)
        os.rename(unready, path)
    except BaseException:
        listener.close()
        with suppress(OSError):
            os.unlink(unready)
        raise
    return listener


def _group_id(name: str) -> int:
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise ConfigError(f"there is no group {name!r} on this machine", key="service.local_operators") from None
