"""The lock of a shaker's port: one holder, known to others, free when its process is gone, no refusal to stop."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from labdaemon.service.shaker_lock import (
    FOLDER_VARIABLE,
    ShakerLock,
    ShakerLockConflict,
    lock_holder,
    lock_keys,
    wait_free,
)

PORT = "socket://127.0.0.1:4001"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    return tmp_path


def test_a_second_holder_is_refused_and_learns_who_has_it() -> None:
    first = ShakerLock(PORT, "daemon", config="rig.toml")
    first.note(commands="tcp://127.0.0.1:5570")
    with pytest.raises(ShakerLockConflict, match=f"process {os.getpid()} for rig.toml") as refused:
        ShakerLock("rfc2217://localhost:4001", "daemon")
    assert refused.value.exit_status == 2
    assert refused.value.holder.commands == "tcp://127.0.0.1:5570"
    first.release()
    assert lock_holder(PORT, "daemon") is None
    ShakerLock(PORT, "daemon").release()


def test_daemon_and_guardian_hold_a_lock_each() -> None:
    daemon, guardian = ShakerLock(PORT, "daemon"), ShakerLock(PORT, "guardian")
    holder = wait_free(PORT, "guardian", 0.05)
    assert holder is not None
    assert holder.role == "guardian"
    guardian.release()
    assert wait_free(PORT, "guardian", 0.05) is None
    daemon.release()


def test_a_killed_process_holds_nothing() -> None:
    held = "from labdaemon.service.shaker_lock import ShakerLock; import sys; x = ShakerLock(sys.argv[1], 'daemon')"
    child = subprocess.Popen(
        [sys.executable, "-c", f"{held}; print(flush=True); sys.stdin.read()", PORT],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with child:
        assert child.stdout is not None
        child.stdout.readline()
        holder = lock_holder(PORT, "daemon")
        assert holder is not None
        assert holder.pid == child.pid
        child.kill()
        child.wait()
    assert lock_holder(PORT, "daemon") is None


def test_a_link_and_the_device_it_leads_to_are_one_port(folder: Path) -> None:
    device, link = folder / "ttyUSB0", folder / "by-id"
    device.touch()
    link.symlink_to(device)
    lock = ShakerLock(str(link), "daemon")
    with pytest.raises(ShakerLockConflict):
        ShakerLock(str(device), "daemon")
    link.unlink()  # the device is gone, and its link with it
    with pytest.raises(ShakerLockConflict):
        ShakerLock(str(link), "daemon")
    lock.release()


@pytest.mark.parametrize("other", ["socket://127.0.0.1:4002", "socket://10.0.0.7:4001", "/dev/ttyUSB0"])
def test_other_ports_are_other_keys(other: str) -> None:
    assert not set(lock_keys(other)) & set(lock_keys(PORT))


def test_where_no_lock_can_be_made_the_stop_is_not_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "absent"))
    assert not ShakerLock(PORT, "daemon").descriptors


def test_devices_of_the_own_process_need_no_lock() -> None:
    first, second = ShakerLock("sim://shaker", "daemon"), ShakerLock("sim://shaker", "daemon")
    assert not first.descriptors
    assert not second.descriptors
    assert lock_holder("sim://shaker", "daemon") is None


def test_a_note_that_is_none_names_nobody(folder: Path) -> None:
    lock = ShakerLock(PORT, "daemon")
    [file] = folder.iterdir()
    file.write_bytes(b"\xff{" * 10)
    holder = lock_holder(PORT, "daemon")
    assert holder is not None
    assert holder.pid is None
    lock.release()
