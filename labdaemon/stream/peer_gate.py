"""The door of a socket: accepts the peers of a TCP port, so many and no more, and connects each to libzmq.

libzmq accepts whoever comes, until the process has no descriptor left for the shaker's port, a frame or the journal.
Here the number is bounded, what never speaks has to leave, and a system without descriptors is waited out. libzmq
itself listens on a socket of the machine that only this process knows the name of.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import resource
import shutil
import socket
import tempfile
import time
import uuid

import zmq

from labdaemon.stream.curve_door import CurveDoor, sender_of
from labdaemon.stream.listener import SocketFile, listen, stop_listening, watch_peer
from labdaemon.stream.long_messages import LongMessages
from labdaemon.stream.peer_connection import NOT_NOW, PeerConnection
from labdaemon.stream.zmtp import LONG_BYTES, PeerLimits

BACKLOG = 4096
"""Newcomers that wait in the system's queue; it may grant fewer."""
RESERVED = 320
"""Descriptors that are left to devices, journal, frames and workers."""
MOST_PEERS = 200  # each takes descriptors of the thousand or so that a process has
LEAST_PEERS = 8  # where the system allows few descriptors, a rig's own programs still connect
GATES = 2  # commands and events
DESCRIPTORS_A_PEER = 4
"""Its TCP socket, both ends of its connection to libzmq, and where keys are checked a socket that listens for it."""
HANDSHAKE_S = 5.0
"""A peer that has not said hello by then is none."""
HELLO_S = 0.5
"""When all places are taken, it has to say hello within this time."""
SHORT_FOLDERS = ("/tmp", "/dev/shm")
"""Where a private folder is made when that for temporary files has too long a name."""
LONGEST_FOLDER = 107 - len("/labdaemon-12345678/inner-1234567890")
"""Bytes of a folder's name that leave room for a socket in it: Linux ends a socket's path at 107."""
IDLE_S = 0.3  # a peer whose handshake takes longer is no program on this machine
WAITS_S = 60.0
"""A peer of the commands socket that was silent for so long gives its place to a newcomer when all are taken; one that
may wait for an answer keeps it for longer."""
CROWD_AT_A_TIME = 8  # let in between two turns of the loop, so that a crowd delays no interlock
CROWD_PAUSE_S = 0.02
"""When all places are taken, so many newcomers are let in at a time, and then none for a while. Thousands of leaked
clients come back ten times a second each; an operator's turn among them comes within seconds."""
EXHAUSTED_PAUSE_S = 0.5  # without descriptors the listener would spin
LOG_EVERY_S = 60.0  # a flood of refusals must not fill the log

log: logging.Logger = logging.getLogger(__name__)


def most_peers() -> int:
    """Connections that one gate lets in: the descriptors that the system grants are shared out."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit == resource.RLIM_INFINITY:
        return MOST_PEERS
    return min(max((limit - RESERVED) // (GATES * DESCRIPTORS_A_PEER), LEAST_PEERS), MOST_PEERS)


def inner_address(*, is_private: bool = False) -> str:
    """A name for libzmq's own socket, which leaves no file behind where the system can do without one.

    Parameters
    ----------
    is_private
        Whether other users of the machine must not reach it: then it lies in a folder that only this user can open.

    Raises
    ------
    OSError
        No folder for temporary files can be written, or the names of all of them are too long for a socket.
    """
    if not is_private:
        return f"ipc://@labdaemon-{os.getpid()}-{uuid.uuid4().hex}"
    candidates = [tempfile.gettempdir(), os.environ.get("XDG_RUNTIME_DIR", ""), *SHORT_FOLDERS]
    short = [folder for folder in candidates if folder and len(os.fsencode(folder)) <= LONGEST_FOLDER]
    failure = OSError(errno.ENAMETOOLONG, f"the folder for temporary files, {candidates[0]}, is too long for a socket")
    for folder in short:
        try:
            return f"ipc://{tempfile.mkdtemp(prefix='labdaemon-', dir=folder)}/inner"
        except OSError as exc:
            failure = exc
    raise failure


def remove_inner(address: str) -> None:
    """Remove the folder of a private `inner_address`; harmless for a name without one."""
    path = address.removeprefix("ipc://")
    if not path.startswith("@"):
        shutil.rmtree(os.path.dirname(path), ignore_errors=True)  # empty, or nearly


class PeerGate:
    """Lets peers in.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT``; port ``*`` takes a free one. HOST may be an IPv6 address in brackets.
    inner
        Where libzmq listens, see `inner_address`.
    limits
        What one peer may send.
    evicts_idle
        Whether a silent peer gives its place to a newcomer when all are taken. Subscribers are silent by nature: there
        the newcomer is turned away.
    most
        Connections at a time.
    door
        Checks the keys of those that come; None where nothing is encrypted.
    place
        Of a Unix socket: its file's mode and group.

    Attributes
    ----------
    address
        With the port that was taken.
    refusals
        Connections that were turned away or ended for what they sent.
    long_messages
        Bounds what all peers together have on its way in.
    """

    def __init__(
        self,
        address: str,
        inner: str,
        limits: PeerLimits,
        *,
        evicts_idle: bool,
        most: int | None = None,
        door: CurveDoor | None = None,
        place: SocketFile | None = None,
    ) -> None:
        self._limits, self._evicts_idle = limits, evicts_idle
        self.door = door
        self._inner = inner.removeprefix("ipc://")
        self._most = most if most is not None else most_peers()
        self._connections: list[PeerConnection] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._logged_s = -LOG_EVERY_S
        self.refusals: int = 0
        self.long_messages: LongMessages = LongMessages()
        self.address: str
        self._listener, self.address = listen(address, BACKLOG, place)

    def open(self) -> None:
        """Let peers in from now on. Call it on the event loop; again is harmless."""
        if self._loop is None:
            self._loop = asyncio.get_running_loop()
            self._accept_again()
            self._sweep()
            if self.door is not None:
                self.door.open(self._end_unlisted)

    def note_received(self, frame: zmq.Frame) -> str | None:
        """Note a message that came out of libzmq, by one of its frames.

        Returns
        -------
        str | None
            The key that its sender has proved to have; None where nothing is encrypted.
        """
        if self.door is None:
            return None
        public, number = sender_of(frame)
        connection = self.door.connection(number)
        if connection is not None:
            connection.note_received()
        return public

    def note_done(self, cost: int) -> None:
        """Note that the daemon holds a message no more, of which `message_cost` is given.

        Where nothing is encrypted it is not known whose that was; else `note_received` has noted it.
        """
        if self.door is None and cost > LONG_BYTES:
            self.long_messages.was_taken()

    def count_topic(self, frame: zmq.Frame) -> None:
        """Count a subscription, or its end, that came out of libzmq."""
        if self.door is not None and (connection := self.door.connection(sender_of(frame)[1])) is not None:
            connection.count_topic(1 if frame.bytes[:1] == b"\x01" else -1)

    def shut(self) -> None:
        """Check no more keys, before libzmq ends: its context waits for the socket on which it asks."""
        if self.door is not None:
            self.door.close()

    def close(self) -> None:
        """Give the port back; what libzmq still had for the peers is sent as far as they take it at once."""
        if self._loop is not None:
            self._loop.remove_reader(self._listener)
        for timer in self._timers.values():
            timer.cancel()
        stop_listening(self._listener, self.address)
        self.shut()
        remove_inner(self._inner)
        for connection in list(self._connections):
            connection.deliver()
            connection.close()

    def _accept_again(self) -> None:
        if self._loop is not None and self._listener.fileno() >= 0:
            self._loop.add_reader(self._listener, self._accept)

    def _accept(self) -> None:
        for _ in range(CROWD_AT_A_TIME):
            is_full = len(self._connections) >= self._most
            victim = self._least_missed() if is_full else None
            if is_full and victim is None and self._evicts_idle:
                break  # newcomers wait in the system's queue: a client that is turned away comes back at once
            try:
                peer, _ = self._listener.accept()
            except NOT_NOW:  # all that knocked are let in
                return
            except OSError as exc:
                self._note(f"a connection could not be accepted ({exc.strerror}); tried again")
                if exc.errno in {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}:
                    self._pause(EXHAUSTED_PAUSE_S)
                return
            if victim is not None:
                victim.close("its place was needed")
            self._let_in(peer)
        if len(self._connections) >= self._most:
            self._pause(CROWD_PAUSE_S)

    def _let_in(self, peer: socket.socket) -> None:
        if len(self._connections) >= self._most:
            peer.close()
            self._note(f"all {self._most} places are taken")
            return
        try:
            peer.setblocking(False)
            if peer.family != socket.AF_UNIX:
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                watch_peer(peer)
        except OSError:
            peer.close()  # it has left already
            return
        is_encrypted = self.door is not None
        self._connections.append(
            PeerConnection(
                peer, self._limits, self._connect, self._forget, self.long_messages, is_encrypted=is_encrypted
            )
        )

    def _least_missed(self) -> PeerConnection | None:
        """The connection that may give its place to another: the longest silent of those that wait for nothing."""
        now_s = time.monotonic()
        strangers = [connection for connection in self._connections if not connection.is_ready]
        silent = [connection for connection in strangers if now_s - connection.accepted_s > HELLO_S]
        if not silent and self._evicts_idle:
            idle = [connection for connection in self._connections if now_s - connection.active_s > IDLE_S]
            silent = [connection for connection in idle if not connection.is_waiting]
            silent = silent or [one for one in idle if now_s - one.active_s > WAITS_S]
        return min(silent, key=lambda connection: connection.active_s, default=None)

    def _connect(self, connection: PeerConnection) -> socket.socket:
        """To libzmq, which accepts at once or is full."""
        name = self._inner if self.door is None else self.door.endpoint(connection).removeprefix("ipc://")
        inner = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            inner.setblocking(False)
            inner.connect(name.replace("@", "\0", 1) if name[:1] == "@" else name)
        except OSError:
            inner.close()
            raise
        return inner

    def _forget(self, connection: PeerConnection, why: str) -> None:
        self._connections.remove(connection)
        if self.door is not None:
            self.door.leave(connection)
        if why:
            self._note(why)

    def _sweep(self) -> None:
        """End, every second, what has not become a peer."""
        if self._loop is None:
            return
        now_s = time.monotonic()
        for connection in list(self._connections):
            if not connection.is_ready and now_s - connection.accepted_s > HANDSHAKE_S:
                connection.close("it never said hello")
            elif connection.is_endless:
                connection.close("a message without end")
        self.long_messages.sweep()
        self._timers["sweep"] = self._loop.call_later(1.0, self._sweep)

    def _end_unlisted(self) -> None:
        """The list of clients has changed: those that it no longer has are out."""
        for connection in list(self._connections):
            if self.door is not None and connection.public is not None and not self.door.is_listed(connection.public):
                connection.close("its key is no longer listed")

    def _pause(self, seconds: float) -> None:
        if self._loop is not None:
            self._loop.remove_reader(self._listener)
            self._timers["accept"] = self._loop.call_later(seconds, self._accept_again)

    def _note(self, why: str) -> None:
        """One line a minute at most, however many are turned away."""
        self.refusals += 1
        now_s = time.monotonic()
        if now_s - self._logged_s >= LOG_EVERY_S:
            self._logged_s = now_s
            log.warning("%s: connection refused: %s (%d so far)", self.address, why, self.refusals)
