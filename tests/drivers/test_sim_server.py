"""The simulated rig as a process of its own: found, asked, outliving the host, ending with its parent."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from importlib.metadata import entry_points

import pytest

from labdaemon.errors import TransportError
from labdrivers.ptp.camera import PtpCamera
from labdrivers.scpi import ScpiShaker
from labdrivers.sim.server import start
from labdrivers.trigger_box import TriggerBox


@pytest.fixture(scope="module")
def running():
    (entry,) = entry_points(group="labdaemon.simulators", name="rig")
    assert entry.load() is start
    with start(small=True) as found:
        yield found


@pytest.fixture
def devices(running, make_shaker):
    shaker = make_shaker(running.addresses.ports["shaker"])
    trigger = TriggerBox("trigger", {"port": running.addresses.ports["trigger"]})
    trigger.connect()
    camera = PtpCamera("left", camera_settings(running))
    camera.connect()
    camera.configure(exposure_s=0.01)
    yield shaker, trigger, camera
    camera.close()
    trigger.close()


def camera_settings(running, serial="6000001"):
    url = running.addresses.backend_url
    return {"driver": "ptp", "serial": serial, "backend": "sim-remote", "backend_url": url, "timeout_s": 5.0}


def test_a_capture_through_all_its_wires(running, devices, tmp_path, eventually):
    shaker, trigger, camera = devices
    trigger.raise_enable()
    shaker.set(5.0, 1.0)
    assert eventually(lambda: running.table()["moving"])
    before = len(running.truth())
    firing = trigger.fire(0.01, frequency_hz=5.0)
    file = camera.wait_file(30.0)
    camera.download(file, tmp_path / file.name)
    assert (tmp_path / file.name).stat().st_size == file.size_bytes
    assert file.name in running.control.ask("cards")["left"]
    record = next(r for r in running.truth()[before:] if r["camera"] == "left")
    assert record["frequency_hz"] == 5.0
    assert abs(record["targets"]["L01"]["ax_mm"]) < 5.0
    opened = firing.opened_at.isoformat()
    assert record["opened_at"][:19] == opened[:19] or record["opened_at"][:16] == opened[:16]
    trigger.drop_enable()
    assert eventually(lambda: not running.table()["moving"])
    assert running.table()["enabled"] is False
    shaker.stop()


def test_faults_and_plugs_from_outside(running, devices, eventually):
    shaker, trigger, camera = devices
    table = running.control.ask("faults")
    assert set(table) == {"shaker", "trigger", "gauge-table", "gauge-response", "left", "right", "shutter"}
    assert all(len(faults) >= 12 for name, faults in table.items() if name != "shutter")
    running.inject("shaker", "silent")
    with pytest.raises(TransportError):
        shaker.state()
    running.clear()
    shaker.connect()
    running.control.ask("unplug", device="left")
    with pytest.raises(TransportError, match="gone from the bus"):
        camera.status()
    running.control.ask("plug", device="left")
    camera.connect()
    trigger.wait(0.0)
    running.control.ask("edge")
    assert trigger.wait(30.0) is not None
    for nonsense in ({"do": "dance"}, {"do": "inject", "device": "toaster", "fault": "hot"}, {"do": "unplug"}):
        with pytest.raises(ValueError, match=r"no request|toaster|device"):
            running.control.ask(**nonsense)


@pytest.mark.slow
def test_a_host_that_dies_lets_go_of_its_cameras(running, eventually):
    program = (
        "import json,sys,time; from labdrivers.ptp.camera import PtpCamera; "
        "c = PtpCamera('right', json.loads(sys.argv[1])); c.connect(); print('held', flush=True); time.sleep(60)"
    )
    settings = camera_settings(running, "6000002")
    host = subprocess.Popen([sys.executable, "-c", program, json.dumps(settings)], stdout=subprocess.PIPE, text=True)
    assert host.stdout.readline() == "held\n"
    camera = PtpCamera("right", settings)
    with pytest.raises(TransportError, match="held by another program"):
        camera.connect()
    host.kill()
    host.wait()
    host.stdout.close()
    assert eventually(lambda: connects(camera))
    camera.close()


def connects(camera):
    try:
        return bool(camera.connect())
    except TransportError:
        return False


@pytest.mark.slow
def test_the_table_moves_on_when_the_host_is_gone(running, make_shaker, eventually):
    """And with it the enable line falls: what a dead computer leaves behind comes to rest by itself."""
    shaker = make_shaker(running.addresses.ports["shaker"])
    trigger = TriggerBox("trigger", {"port": running.addresses.ports["trigger"], "hold_enable_ms": 800})
    trigger.connect()
    trigger.raise_enable()
    shaker.set(5.0, 1.0)
    shaker.close()
    trigger.close()
    assert running.table()["moving"]
    assert eventually(lambda: not running.table()["moving"])
    again = ScpiShaker("shaker", {**vars_of(make_shaker), "port": running.addresses.ports["shaker"]})
    again.connect()
    assert again.state().running
    again.stop_now()
    again.close()


def vars_of(make_shaker):
    driver = make_shaker(connect=False)
    return driver._settings.model_dump(exclude_unset=True)


def test_the_rig_file_is_rewritten_to_its_ports(running):
    rig = {
        "shaker": {"driver": "scpi", "port": "sim://shaker"}, "trigger": {"driver": "box", "port": "x"},
        "gauge": [{"name": "table", "role": "table", "port": "x"}, {"name": "top", "role": "response", "port": "x"}],
        "cameras": {"left": {"driver": "ptp", "serial": "6000001"}},
    }  # fmt: skip
    found = running.rig_file(rig)
    assert found["shaker"]["port"] == running.addresses.ports["shaker"]
    assert found["gauge"][1]["port"] == running.addresses.ports["gauge-response"]
    assert found["cameras"]["left"]["backend_url"].startswith("tcp://")
    assert rig["trigger"]["port"] == "x"


@pytest.mark.slow
@pytest.mark.parametrize("end", ["signal", "signal to another thread", "parent", "quit"])
def test_it_ends(end, eventually):
    keeper = (
        "import sys,time; from labdrivers.sim.server import start; rig = start(small=True); "
        "print(rig.pid, rig.addresses.control, flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", keeper], stdout=subprocess.PIPE, text=True) as parent:
        try:
            pid, control = parent.stdout.readline().split()
            if end == "signal":
                os.kill(int(pid), signal.SIGTERM)
            elif end == "signal to another thread":  # as a kernel may choose
                thread = next(t for t in os.listdir(f"/proc/{pid}/task") if t != pid)
                assert ctypes.CDLL(None).tgkill(int(pid), int(thread), int(signal.SIGTERM)) == 0
            elif end == "parent":
                parent.kill()
            else:
                from labdrivers.sim.control import ControlClient

                client = ControlClient(control)
                client.ask("quit")
                client.close()
            assert eventually(lambda: gone(int(pid)))
        finally:
            parent.kill()


def gone(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_the_program_explains_itself():
    done = subprocess.run([sys.executable, "-m", "labdrivers.sim.server", "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert "--small" in done.stdout


@pytest.mark.slow
def test_a_simulator_that_is_gone_is_a_transport_error(make_shaker):
    with start(small=True) as rig:
        camera = PtpCamera("left", camera_settings(rig))
        camera.connect()
        shaker = make_shaker(rig.addresses.ports["shaker"])
    began = time.monotonic()
    with pytest.raises(TransportError):
        camera.status()
    with pytest.raises(TransportError):
        shaker.state()
    with pytest.raises(TransportError):
        camera.connect()
    assert time.monotonic() - began < 60.0
    camera.close()
