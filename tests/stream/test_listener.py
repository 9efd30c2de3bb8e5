"""Unix sockets: who may connect, and what a daemon that was killed leaves behind."""

from __future__ import annotations

import grp
import os
import socket
import stat
from pathlib import Path

import pytest

from labdaemon.errors import ConfigError
from labdaemon.stream.client import Client
from labdaemon.stream.listener import GONE_S, SocketFile, listen, stop_listening, watch_peer
from labdaemon.stream.sockets import DoorPolicy
from labdaemon.testing.stream_daemon import StreamDaemon


@pytest.fixture
def address(socket_folder: Path) -> str:
    return f"ipc://{socket_folder}/c.sock"


def mode_of(address: str) -> int:
    return stat.S_IMODE(os.stat(address.removeprefix("ipc://")).st_mode)


@pytest.mark.parametrize("mode", [0o600, 0o660, 0o666])
def test_the_file_says_who_may_connect(address: str, mode: int) -> None:
    listener, where = listen(address, 8, SocketFile(mode, grp.getgrgid(os.getgid()).gr_name))
    assert (where, mode_of(address)) == (address, mode)
    stop_listening(listener, address)
    assert not os.path.exists(address.removeprefix("ipc://"))


def test_the_file_of_a_killed_daemon_is_replaced(address: str) -> None:
    listener, _ = listen(address, 8)
    listener.close()  # as a kill does: the file stays
    again, _ = listen(address, 8)
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(address.removeprefix("ipc://"))
    stop_listening(again, address)


def test_two_daemons_do_not_share_a_path(address: str) -> None:
    listener, _ = listen(address, 8)
    with pytest.raises(OSError, match="another program listens"):
        listen(address, 8)
    stop_listening(listener, address)


def test_a_file_that_is_no_socket_is_left_alone(address: str, socket_folder: Path) -> None:
    (socket_folder / "c.sock").write_text("mine")
    with pytest.raises(OSError, match="another file"):
        listen(address, 8)
    assert (socket_folder / "c.sock").read_text() == "mine"


def test_a_group_that_is_not_there_is_named(address: str) -> None:
    with pytest.raises(ConfigError, match="no group 'nosuchgroup'"):
        listen(address, 8, SocketFile(0o660, "nosuchgroup"))


def test_a_client_commands_and_hears_over_unix_sockets(socket_folder: Path) -> None:
    daemon = StreamDaemon(DoorPolicy(place=SocketFile()))
    daemon.commands, daemon.events = f"ipc://{socket_folder}/c.sock", f"ipc://{socket_folder}/e.sock"
    daemon.start()
    try:
        assert {mode_of(daemon.commands), mode_of(daemon.events)} == {0o600}
        with Client(daemon.commands, daemon.events, timeout_s=20) as lab:
            assert next(lab.events(timeout_s=20))["kind"] == "status"
            assert lab.call("stop")["rest"] == "shaker"
        # Other users must not find the way past the file's permissions either: abstract names have none.
        assert not [line for line in Path("/proc/net/unix").read_text().splitlines() if f"-{os.getpid()}-" in line]
    finally:
        daemon.stop()
    assert list(socket_folder.iterdir()) == []


def test_a_long_folder_for_temporary_files_is_no_obstacle(socket_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    long = socket_folder / ("x" * 120)
    long.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(long))
    monkeypatch.setattr("labdaemon.stream.peer_gate.SHORT_FOLDERS", (str(socket_folder / "none"), str(socket_folder)))
    daemon = StreamDaemon(DoorPolicy(place=SocketFile()))
    daemon.commands, daemon.events = f"ipc://{socket_folder}/c.sock", f"ipc://{socket_folder}/e.sock"
    daemon.start()
    try:
        assert len(list(socket_folder.glob("labdaemon-*"))) == 2
        with Client(daemon.commands, daemon.events, timeout_s=20) as lab:
            assert lab.call("stop")["rest"] == "shaker"
    finally:
        daemon.stop()
    assert list(long.iterdir()) == []
    assert list(socket_folder.iterdir()) == [long]


def test_without_a_short_folder_the_message_says_what_is_too_long(
    socket_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", "/tmp/" + "x" * 120)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("labdaemon.stream.peer_gate.SHORT_FOLDERS", ())
    daemon = StreamDaemon(DoorPolicy(place=SocketFile()))
    daemon.commands, daemon.events = f"ipc://{socket_folder}/c.sock", f"ipc://{socket_folder}/e.sock"
    with pytest.raises(ConfigError, match=r"temporary files, /tmp/x+, is too long"):
        daemon.start()


def test_the_inner_socket_lies_in_a_private_folder(socket_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(socket_folder))
    daemon = StreamDaemon(DoorPolicy(place=SocketFile()))
    daemon.commands, daemon.events = f"ipc://{socket_folder}/c.sock", f"ipc://{socket_folder}/e.sock"
    daemon.start()
    try:
        folders = [path for path in socket_folder.iterdir() if path.is_dir()]
        assert [stat.S_IMODE(path.stat().st_mode) for path in folders] == [0o700, 0o700]
    finally:
        daemon.stop()
    assert list(socket_folder.iterdir()) == []


@pytest.mark.parametrize("is_written_to", [False, True])
def test_the_system_ends_connections_of_computers_that_went_without_a_word(is_written_to: bool) -> None:
    listener, where = listen("tcp://127.0.0.1:*", 8)
    host, _, port = where.removeprefix("tcp://").rpartition(":")
    with listener, socket.create_connection((host, int(port)), timeout=60), listener.accept()[0] as peer:
        watch_peer(peer, is_written_to=is_written_to)
        assert peer.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        asked = [peer.getsockopt(socket.IPPROTO_TCP, option) for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL)]
        assert max(asked) <= 30
        assert peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 1000 * GONE_S * is_written_to
