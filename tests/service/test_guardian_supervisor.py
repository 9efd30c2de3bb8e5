"""The guardian against real endings of a real process, with a table that nothing else stops."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from labdaemon.service.guardian_context import take_report, wait_for_guardian
from labdaemon.service.shaker_lock import lock_holder
from labdrivers.sim.assembly import SimulatedRig
from labdrivers.sim.spec import RigSpec
from labdrivers.sim.wire import PtyPort, TcpPort

PROGRAM = Path(__file__).with_name("guarded_program.py")
PATIENCE_S = 90.0
SPEC = RigSpec()


def until(condition, timeout_s: float = PATIENCE_S) -> bool:
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


class GuardedProcess:
    """`guarded_program.py` as a process, and what it has said."""

    def __init__(self, port: str, folder: Path) -> None:
        limits = {"stroke_mm": 150, "velocity_mm_s": 600, "acceleration_mm_s2": 12000, "frequency_hz": [0.5, 25]}
        drive = [{"frequency_hz": f, "mm_per_v": gain} for f, gain in SPEC.table.calibration()]
        config, self.report = folder / "shaker.json", folder / "guardian.json"
        config.write_text(json.dumps({"driver": "scpi", "limits": limits, "drive": drive, "ramp_mm_s": 40.0}))
        self.process = subprocess.Popen(
            [sys.executable, str(PROGRAM), port, str(config), str(self.report)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self._said: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        self.guardian = self.said()["pid"]

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._said.put(line)

    def said(self) -> dict:
        return json.loads(self._said.get(timeout=PATIENCE_S))

    def do(self, word: str) -> None:
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        until(lambda: is_gone(self.guardian))
        self.process.stdout.close()


@pytest.fixture
def table(tmp_path, monkeypatch):
    """A simulated rig whose amplifier needs no enable line."""
    monkeypatch.setenv("LABDAEMON_LOCKS", str(tmp_path))
    rig = SimulatedRig(SPEC, cards=tmp_path / "cards", enable_wired=False)
    yield rig
    rig.shut_down()


@pytest.fixture(params=["tcp"])
def ward(request, table, tmp_path):
    port = PtyPort(table.shaker) if request.param == "pty" else TcpPort(table.shaker)
    url = port.path if request.param == "pty" else port.url
    found = GuardedProcess(url, tmp_path)
    found.port = url
    assert until(table.moving)
    yield found
    found.close()
    port.close()


def endings(ward):
    return {
        "KILL": ward.process.kill,
        "ABRT": lambda: ward.process.send_signal(signal.SIGABRT),
        "SEGV": lambda: ward.process.send_signal(signal.SIGSEGV),
        "STOP": lambda: ward.process.send_signal(signal.SIGSTOP),
        "hung loop": lambda: ward.do("hang"),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ward", "how"),
    [("tcp", "KILL"), ("pty", "KILL"), ("tcp", "ABRT"), ("tcp", "SEGV"), ("pty", "STOP"), ("tcp", "hung loop")],
    indirect=["ward"],
)
def test_the_table_comes_to_rest(ward, table, how):
    endings(ward)[how]()
    assert until(lambda: not table.moving())  # how soon is the bench's: this machine may be busy
    assert until(lambda: is_gone(ward.guardian))
    assert ward.process.wait(PATIENCE_S) < 0
    report = take_report(ward.report)
    assert "saw it at rest" in report
    assert ("silent for" in report) == (how in ("STOP", "hung loop"))
    assert take_report(ward.report) is None
    assert until(lambda: lock_holder(ward.port, "guardian") is None)  # its threads end one by one


@pytest.mark.slow
def test_a_forked_child_that_holds_the_pipe_does_not_hide_the_death(ward, table):
    ward.do("fork")
    child = ward.said()["child"]
    ward.process.kill()
    assert until(lambda: not table.moving())
    assert until(ward.report.exists)
    report = take_report(ward.report)
    os.kill(child, signal.SIGKILL)
    assert "ended without" in report  # not by its silence, which takes longer


@pytest.mark.slow
def test_an_end_without_rest_keeps_its_exit_status_and_the_guardian_goes_on(ward, table):
    ward.do("give up")
    assert ward.process.wait(PATIENCE_S) == 1  # it is not killed while the interpreter ends
    assert until(lambda: not table.moving())


@pytest.mark.slow
def test_nothing_but_its_end_or_rest_ends_the_guardian(ward, table):
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGRTMIN):
        os.kill(ward.guardian, number)
    ward.do("describe")
    assert ward.said()["pid"] == ward.guardian
    assert lock_holder(ward.port, "guardian").pid == ward.guardian
    ward.process.kill()
    assert until(lambda: not table.moving())


@pytest.mark.slow
def test_a_lost_guardian_is_reported_and_replaced(ward, table):
    os.kill(ward.guardian, signal.SIGKILL)
    assert "has ended (signal 9)" in ward.said()["lost"]

    def is_replaced():
        ward.do("describe")
        return ward.said()["pid"] not in (None, first)

    first = ward.guardian
    assert until(is_replaced)
    ward.do("describe")
    ward.guardian = ward.said()["pid"]
    ward.process.kill()
    assert until(lambda: not table.moving())


@pytest.mark.slow
def test_a_guardian_that_is_stopped_is_lost(ward):
    os.kill(ward.guardian, signal.SIGSTOP)
    assert "has not answered" in ward.said()["lost"]
    ward.do("end")
    assert ward.process.wait(PATIENCE_S) == 0
    assert is_gone(ward.guardian)


@pytest.mark.slow
def test_it_is_tiny_has_a_session_of_its_own_and_is_let_go_at_rest(ward):
    assert os.getsid(ward.guardian) == ward.guardian != os.getsid(ward.process.pid)
    maps = Path(f"/proc/{ward.guardian}/maps").read_text()
    assert not [name for name in ("numpy", "pydantic", "zmq", "cv2", "scipy") if name in maps]
    [resident] = [line for line in Path(f"/proc/{ward.guardian}/status").read_text().splitlines() if "VmRSS" in line]
    assert int(resident.split()[1]) < 30_000  # kB
    open_files = {os.readlink(path) for path in Path(f"/proc/{ward.guardian}/fd").iterdir()}
    assert not [name for name in open_files if "socket" in name]
    ward.do("end")
    assert ward.process.wait(PATIENCE_S) == 0
    assert is_gone(ward.guardian)
    assert not ward.report.exists()


@pytest.mark.slow
def test_a_later_daemon_waits_for_the_guardian_that_is_still_at_it(ward, table, monkeypatch):
    table.shaker.faults.inject("silent")
    ward.process.kill()
    ward.process.wait()
    waiting = threading.Thread(target=wait_for_guardian, args=(ward.port,))
    waiting.start()
    waiting.join(0.5)
    assert waiting.is_alive()
    waiting.join(PATIENCE_S)
    assert is_gone(ward.guardian)  # it has handed over
    assert "did NOT see it at rest" in take_report(ward.report)


def test_an_adopter_of_orphans_is_never_taken_for_the_daemon():
    """A guardian whose daemon died before it looked has another parent, which must not be killed."""
    call = "print(GuardedProcess(int(sys.argv[1])).end(0.0))"
    program = f"import os, sys; from labdaemon.guardian.guarded_process import GuardedProcess; {call}"
    gone = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    done = subprocess.run([sys.executable, "-c", program, gone.stdout.strip()], capture_output=True, text=True)
    assert done.stdout == "False\n", done.stderr


def test_what_the_guardian_imports():
    """The standard library and pyserial alone: whatever else it loaded could fail, or need memory that is not there."""
    program = (
        "import sys; sys.path += sys.argv[1:]; import labdaemon.guardian.heartbeat_monitor, json; "
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules} - set(sys.stdlib_module_names))))"
    )
    import serial

    import labdaemon

    folders = [str(Path(module.__file__).parents[1]) for module in (labdaemon, serial)]
    done = subprocess.run([sys.executable, "-I", "-S", "-c", program, *folders], capture_output=True, text=True)
    assert set(json.loads(done.stdout)) <= {"labdaemon", "serial", "__main__"}
