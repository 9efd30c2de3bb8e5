from __future__ import annotations

import threading
import time

import pytest

from labdaemon.errors import ConfigError, DeviceRefused, TransportError
from labdrivers.ptp.camera import PtpCamera
from labdrivers.ptp.codes import Op


def shoot(rig, name="left"):
    assert rig.bus.cameras[name].body.release(rig.clock()) is not None


def test_a_body_is_known_by_its_number(rig, make_camera):
    right = make_camera("6000002")
    info = right.connect()
    assert (info.manufacturer, info.model, info.serial) == ("Nikon Corporation", "NIKON DSC D80", "6000002")
    with pytest.raises(TransportError, match=r"no camera with serial number 77 on USB.*or correct `serial` in the rig"):
        make_camera("77")


def test_bodies_that_tell_their_number_only_when_asked(rig, make_camera, monkeypatch):
    """Without the number in the USB descriptor each is asked in turn, and let go if it is another."""
    monkeypatch.setattr("labdrivers.ptp.find._descriptor_serial", lambda device: None)
    right = make_camera("6000002")
    assert right.connect().serial == "6000002"
    assert make_camera("6000001").connect().serial == "6000001"  # the right one's claim is not in the way
    right.close()
    with pytest.raises(TransportError, match=r"found NIKON DSC D80 with serial number 6000002, and one that cannot"):
        make_camera("77")
    assert right.connect().serial == "6000002"


def connects_in_vain(camera):
    with pytest.raises(TransportError):
        camera.connect()


def test_a_dead_body_keeps_no_other_waiting(rig, make_camera):
    rig.bus.cameras["left"].faults.inject("silent")
    left, right = make_camera(connect=False, timeout_s=6.0), make_camera("6000002", connect=False)
    waiting = threading.Thread(target=connects_in_vain, args=(left,))
    waiting.start()
    time.sleep(0.2)
    right.connect()
    assert waiting.is_alive()
    rig.bus.unplug("left")
    waiting.join(120)
    assert not waiting.is_alive()


def test_zeros_before_the_number_do_not_matter(make_camera):
    assert make_camera("0006000001").connect().serial == "6000001"


def test_a_camera_held_by_another_program(rig, make_camera):
    first = make_camera()
    with pytest.raises(TransportError, match="held by another program"):
        make_camera()
    first.close()
    make_camera()


def test_the_sensor_data_arrive_as_they_were(rig, camera, tmp_path):
    import rawpy

    shoot(rig)
    file = camera.wait_file(30)
    assert file is not None
    assert file.name == "DSC_0001.DNG"
    to = tmp_path / "left.dng"
    camera.download(file, to)
    card = rig.bus.cameras["left"].body.card
    assert to.read_bytes() == card.read(card.get(file.handle), 0, file.size_bytes)
    with rawpy.imread(str(to)) as raw:
        assert raw.raw_image_visible.shape == (48, 64)
    assert camera.files() == [file]
    camera.delete(file)
    assert camera.files() == []
    camera.delete(file)  # gone already: no error
    with pytest.raises(DeviceRefused, match="has no file"):
        camera.download(file, tmp_path / "again.dng")


def test_nothing_new_within_the_time(camera):
    start = time.monotonic()
    assert camera.wait_file(0.2) is None
    assert 0.2 <= time.monotonic() - start < 20.0


def test_each_file_is_told_once_and_in_order(rig, camera):
    names = []
    for _ in range(3):
        shoot(rig)
        names.append(camera.wait_file(30).name)
        time.sleep(0.1)
    assert names == ["DSC_0001.DNG", "DSC_0002.DNG", "DSC_0003.DNG"]
    assert camera.wait_file(2.5) is None  # the list was compared meanwhile: nothing comes twice


def test_files_from_before_are_listed_but_no_news(rig, make_camera):
    shoot(rig)
    body = rig.bus.cameras["left"].body
    deadline = time.monotonic() + 30
    while len(body.card.handles()) < 3 and time.monotonic() < deadline:
        time.sleep(0.02)
    camera = make_camera()
    assert [file.name for file in camera.files()] == ["DSC_0001.DNG"]
    assert camera.wait_file(0.3) is None


def test_a_replug_changes_the_address_and_loses_no_file(rig, camera, tmp_path):
    shoot(rig)
    first = camera.wait_file(30)
    rig.bus.unplug("left")
    with pytest.raises(TransportError, match="gone from the bus"):
        camera.download(first, tmp_path / "x")
    with pytest.raises(TransportError):
        camera.connect()
    shoot(rig)  # the cable still releases it
    time.sleep(0.5)
    rig.bus.plug("left")
    camera.connect()
    second = camera.wait_file(30)
    assert second.name == "DSC_0002.DNG"
    assert camera.wait_file(0.3) is None
    camera.download(first, tmp_path / "x")
    camera.download(second, tmp_path / "y")


def test_a_broken_download_goes_on_where_it_broke(rig, camera, tmp_path):
    usb = rig.bus.cameras["left"]
    content = bytes(range(256)) * 12000  # three blocks
    usb.body.card.add(content)
    (file,) = camera.files()
    to = tmp_path / "big"
    asked = []
    operate = usb.body.operate

    def watch(code, parameters, data):
        if code == Op.GET_PARTIAL_OBJECT:
            asked.append(parameters[1])
            if len(asked) == 2:
                usb.faults.inject("pipe_error", count=1)
        return operate(code, parameters, data)

    usb.body.operate = watch
    with pytest.raises(TransportError, match="pipe error"):
        camera.download(file, to)
    assert to.stat().st_size == 1 << 20
    camera.close()
    camera.connect()
    camera.download(file, to)
    assert to.read_bytes() == content
    assert asked == [0, 1 << 20, 1 << 20, 2 << 20]


@pytest.mark.parametrize("size", [100, 5000])
def test_a_pipe_error_is_noticed_at_once(rig, make_camera, tmp_path, size):
    """Also where the data phase was whole and only the response is missing."""
    camera = make_camera(timeout_s=60.0)
    rig.bus.cameras["left"].body.card.add(bytes(size))
    (file,) = camera.files()
    rig.bus.cameras["left"].faults.inject("pipe_error", count=1)
    start = time.monotonic()
    with pytest.raises(TransportError, match="pipe error"):
        camera.download(file, tmp_path / "f")
    assert time.monotonic() - start < 30.0
    camera.download(file, tmp_path / "f")


def test_a_longer_file_in_the_way_is_written_over(rig, camera, tmp_path):
    rig.bus.cameras["left"].body.card.add(b"short")
    (file,) = camera.files()
    to = tmp_path / "f"
    to.write_bytes(b"something much longer")
    camera.download(file, to)
    assert to.read_bytes() == b"short"


@pytest.mark.parametrize("size", [0, 1, 499, 500, 501, 512, 1012, 1 << 20, (1 << 20) + 500])
@pytest.mark.parametrize("habit", [None, "no_zlp", "split_header", "unknown_length", "late_zlp"])
def test_any_size_in_any_habit_of_packets(rig, camera, tmp_path, size, habit):
    """Sizes about the packet's: 12 bytes of header and 500 of data fill one exactly."""
    usb = rig.bus.cameras["left"]
    content = bytes(i * 7 % 256 for i in range(size))
    usb.body.card.add(content)
    if habit:
        usb.faults.inject(habit)
    (file,) = camera.files()
    camera.download(file, tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == content


def test_settings_are_set_and_read_back(rig, camera):
    body = rig.bus.cameras["left"].body
    assert camera.configure(exposure_s=1.2, f_number=8.0, iso=200) == pytest.approx(1.3)
    assert (body.settings.f_number, body.settings.iso) == (8.0, 200)
    assert body.settings.exposure_s == pytest.approx(2 ** (1 / 3))  # what "1.3 s" really is
    steps = camera.exposure_steps_s()
    assert steps == tuple(sorted(steps))
    assert steps[0] == pytest.approx(1 / 4000)
    assert steps[-1] == 30.0
    with pytest.raises(DeviceRefused, match="ISO 5000"):
        camera.configure(iso=5000)
    with pytest.raises(DeviceRefused, match="f-number"):
        camera.configure(f_number=64.0)


def test_a_dial_that_decides_is_named(rig, camera):
    rig.bus.cameras["left"].body.settings.dial = "P"
    assert camera.exposure_steps_s() == (0.01,)
    assert camera.configure(exposure_s=0.01) == pytest.approx(0.01)
    with pytest.raises(DeviceRefused, match=r"dial.*0\.01 s.*M"):
        camera.configure(exposure_s=1.0)
    with pytest.raises(DeviceRefused, match="dial"):
        camera.configure(f_number=4.0)


def test_bulb_is_no_exposure_time(rig, camera):
    rig.bus.cameras["left"].body.settings.set(0xD100, 0xFFFFFFFF)
    with pytest.raises(DeviceRefused, match="bulb"):
        camera.configure()


def test_battery_and_space(rig, camera):
    body = rig.bus.cameras["left"].body
    before = camera.status()
    assert before.battery_percent == 90
    body.card.add(bytes(1000))
    assert camera.status().free_bytes == before.free_bytes - 1000
    body.faults.inject("low_battery", value=4)
    assert camera.status().battery_percent == 4


def test_a_full_card_is_said(rig, camera):
    rig.bus.cameras["left"].body.faults.inject("card_full")
    assert camera.status().free_bytes == 0
    shoot(rig)
    with pytest.raises(DeviceRefused, match="card full"):
        camera.wait_file(30)


def test_a_body_that_exposes_longer_than_the_deadline_is_waited_for(rig, make_camera):
    camera = make_camera(timeout_s=0.4)
    camera.configure(exposure_s=1.3)
    shoot(rig)
    start = time.monotonic()
    with pytest.raises(TransportError, match="busy"):
        camera.status()
    assert camera.wait_file(30.0) is not None
    assert 1.2 < time.monotonic() - start < 30.0
    assert camera.status().battery_percent == 90


def test_shots_kept_in_memory_are_each_fetched(rig, camera, tmp_path):
    """They all have one handle and stand in no list."""
    body = rig.bus.cameras["left"].body
    body.faults.inject("to_memory")
    names = []
    for turn in range(3):
        shoot(rig)
        file = camera.wait_file(30.0)
        camera.download(file, tmp_path / str(turn))
        if turn != 1:
            camera.delete(file)
        names.append(file.name)
        time.sleep(0.15)
    assert names == ["DSC_0001.DNG", "DSC_0002.DNG", "DSC_0003.DNG"]
    assert camera.files() == []


def test_two_cameras_work_side_by_side(rig, make_camera, tmp_path):
    cameras = {name: make_camera(serial) for name, serial in (("left", "6000001"), ("right", "6000002"))}
    found = {}

    def work(name):
        for turn in range(5):
            file = cameras[name].wait_file(30)
            cameras[name].download(file, tmp_path / f"{name}{turn}")
            cameras[name].delete(file)
            found.setdefault(name, []).append(file.name)

    threads = [threading.Thread(target=work, args=(name,)) for name in cameras]
    for thread in threads:
        thread.start()
    for _ in range(5):
        for name in cameras:
            shoot(rig, name)
        time.sleep(0.25)
    for thread in threads:
        thread.join(60)
    assert {name: len(files) for name, files in found.items()} == {"left": 5, "right": 5}


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"serial": ""}, "cameras.c.serial"),
        ({"backend": "telepathy"}, "cameras.c.backend"),
        ({"timeout": 3}, "cameras.c.timeout"),
    ],
)
def test_wrong_settings(changes, key):
    with pytest.raises(ConfigError) as caught:
        PtpCamera("c", {"driver": "ptp", "serial": "1", **changes}).connect()
    assert str(caught.value).startswith(key)


def test_keys_of_others_are_left_alone():
    PtpCamera("c", {"driver": "ptp", "serial": "1", "exposure_s": 1.0, "focal_px": [1, 1], "image_size": [1, 1]})


class TestPowerCycle:
    @pytest.fixture
    def relay(self, rig, tmp_path):
        """A relay that gives the left camera its power back when a file appears, and counts."""
        mark, stop, count = tmp_path / "relay", threading.Event(), []

        def watch():
            while not stop.wait(0.02):
                if mark.exists():
                    mark.unlink()
                    count.append(1)
                    rig.bus.cameras["left"].faults.clear()
                    rig.bus.unplug("left")
                    rig.bus.plug("left")

        thread = threading.Thread(target=watch)
        thread.start()
        yield mark, count
        stop.set()
        thread.join()

    def test_a_dead_body_comes_back(self, rig, make_camera, relay):
        mark, count = relay
        command = ["touch", str(mark)]
        camera = make_camera(power_cycle=command, wakes_after_s=5.0, timeout_s=0.3)
        assert count == []  # a body that answers keeps its power
        rig.bus.cameras["left"].faults.inject("silent")
        with pytest.raises(TransportError):
            camera.status()
        camera.connect()
        assert camera.status().battery_percent == 90
        assert count == [1]
        rig.bus.cameras["left"].faults.inject("silent")
        with pytest.raises(TransportError):
            camera.connect()  # not again so soon
        assert count == [1]

    @pytest.mark.parametrize(
        ("command", "words"), [(["false"], "status 1"), (["/no/such/relay"], "No such file"), (["true"], "no camera")]
    )
    def test_a_hook_that_does_not_help(self, rig, make_camera, command, words):
        rig.bus.unplug("left")
        camera = make_camera(power_cycle=command, wakes_after_s=0.1, timeout_s=0.3, connect=False)
        with pytest.raises((DeviceRefused, TransportError), match=words):
            camera.connect()

    def test_what_a_hook_prints_is_bytes(self, rig, make_camera, tmp_path):
        """As uhubctl prints descriptors: one byte that is no UTF-8."""
        rig.bus.unplug("left")
        for status, error in (("0", TransportError), ("1", DeviceRefused)):
            command = ["sh", "-c", f"printf 'relais \\351teint'; exit {status}"]
            camera = make_camera(power_cycle=command, wakes_after_s=0.1, timeout_s=0.3, connect=False)
            with pytest.raises(error):
                camera.connect()
