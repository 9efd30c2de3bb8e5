"""The camera's driver against a PTP responder that nobody here wrote: libgphoto2's virtual Nikon D750.

It comes in the gphoto2 wheel. Its raw pipe is reached with ctypes and put under pyusb as a backend; everything from
`PtpCamera` down to the containers is as with a real body.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from types import SimpleNamespace

import pytest
import usb.backend
from usb.core import USBError, USBTimeoutError

from labdaemon.errors import DeviceRefused
from labdrivers.ptp import camera as camera_module
from labdrivers.ptp.camera import PtpCamera
from labdrivers.ptp.codes import Op

CABLE_SHOT = 0x9999
"""The virtual camera's own operation (0, delay in ms): a file appears as after a shot by cable."""


class GphotoPipe:
    """libgphoto2_port's generic functions on its first port, which `vusb` provides."""

    def __init__(self, library):
        self._lib = library
        pointer = ctypes.c_void_p
        self._list, self._port, info = pointer(), pointer(), pointer()
        self._check(library.gp_port_info_list_new(ctypes.byref(self._list)))
        self._check(library.gp_port_info_list_load(self._list))
        self._check(library.gp_port_info_list_get_info(self._list, 0, ctypes.byref(info)))
        self._check(library.gp_port_new(ctypes.byref(self._port)))
        self._check(library.gp_port_set_info(self._port, info))
        self._check(library.gp_port_open(self._port))
        self._check(library.gp_port_set_timeout(self._port, 10))

    def close(self):
        self._lib.gp_port_close(self._port)
        self._lib.gp_port_free(self._port)
        self._lib.gp_port_info_list_free(self._list)

    def write(self, data):
        return self._check(self._lib.gp_port_write(self._port, data, len(data)))

    def read(self, size, function="gp_port_read"):
        buffer = ctypes.create_string_buffer(size)
        count = getattr(self._lib, function)(self._port, buffer, size)
        return buffer.raw[: max(0, count)]

    @staticmethod
    def _check(result):
        if result < 0:
            raise USBError(f"libgphoto2_port answers {result}", None, 5)
        return result


class GphotoBackend(usb.backend.IBackend):
    """One still-image device, a new pipe for each opening."""

    def __init__(self, library):
        self._lib = library

    def enumerate_devices(self):
        return iter(["d750"])

    def get_parent(self, dev):
        return None

    def get_device_descriptor(self, dev):
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=0x04B0, idProduct=0x0437, bcdDevice=0x100, iManufacturer=0, iProduct=0,
            iSerialNumber=0, bNumConfigurations=1, address=1, bus=1, port_number=1, port_numbers=(1,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev, config):
        if config:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=39, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0xC0, bMaxPower=1, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev, intf, alt, config):
        if intf or alt:
            raise IndexError(intf)
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=3, bInterfaceClass=6,
            bInterfaceSubClass=1, bInterfaceProtocol=1, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        address, attributes, size = ((0x81, 2, 512), (0x02, 2, 512), (0x83, 3, 64))[ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=attributes, wMaxPacketSize=size,
            bInterval=4, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev):
        return GphotoPipe(self._lib)

    def close_device(self, handle):
        handle.close()

    def get_configuration(self, handle):
        return 1

    def set_configuration(self, handle, value):
        pass

    def claim_interface(self, handle, intf):
        pass

    def release_interface(self, handle, intf):
        pass

    def clear_halt(self, handle, ep):
        pass

    def bulk_write(self, handle, ep, intf, data, timeout):
        return handle.write(bytes(data)) if len(data) else 0

    def _wait(self, handle, buff, timeout, function):
        deadline = time.monotonic() + timeout / 1000
        while not (data := handle.read(len(buff), function)):
            if time.monotonic() >= deadline:
                raise USBTimeoutError("timed out", None, 110)
            time.sleep(0.002)
        memoryview(buff).cast("B")[: len(data)] = data
        return len(data)

    def bulk_read(self, handle, ep, intf, buff, timeout):
        return self._wait(handle, buff, timeout, "gp_port_read")

    def intr_read(self, handle, ep, intf, buff, timeout):
        return self._wait(handle, buff, timeout, "gp_port_check_int")

    def ctrl_transfer(self, handle, request_type, request, value, index, data, timeout):
        return 0


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    if sys.platform != "linux":
        pytest.skip("the virtual camera is in the Linux wheel only")
    if "gphoto2" in sys.modules:
        pytest.skip("gphoto2 was imported before VCAMERADIR was set")
    folder = tmp_path_factory.mktemp("vcamera")
    (folder / "x.jpg.NEF").write_bytes(bytes(i * 31 % 251 for i in range(2_500_001)))
    os.environ["VCAMERADIR"] = str(folder)
    gphoto2 = pytest.importorskip("gphoto2", reason="the gphoto2 wheel, a PTP peer of others, is not installed")
    path = os.path.join(os.path.dirname(gphoto2.__file__), "libgphoto2", "libgphoto2_port.so.12")
    if not os.path.exists(path):
        pytest.skip("this gphoto2 is not the wheel with the virtual camera")
    return SimpleNamespace(port=ctypes.CDLL(path), content=(folder / "x.jpg.NEF").read_bytes())


@pytest.fixture
def camera(library, monkeypatch):
    backend = GphotoBackend(library.port)
    monkeypatch.setattr(camera_module, "load_backend", lambda *_, **__: backend)
    driver = PtpCamera("peer", {"serial": "0.1", "timeout_s": 2.0})
    driver.connect()
    yield driver
    driver.close()


def test_who_it_is(camera):
    info = camera.connect()
    assert (info.manufacturer, info.model, info.serial) == ("GP", "VC", "0.1")


def test_status_and_settings(camera):
    status = camera.status()
    assert 0 <= status.battery_percent <= 100
    steps = camera.exposure_steps_s()
    assert status.free_bytes > 0
    assert steps == pytest.approx(
        (0.0001, 0.0012, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 1.0)
    )  # its 500D, tenths of a millisecond
    assert camera.configure(exposure_s=steps[0]) == steps[0]
    assert camera.configure(exposure_s=steps[-1]) == steps[-1]


def test_a_shot_by_cable_is_noticed_fetched_and_deleted(camera, library, tmp_path):
    camera._session.call(CABLE_SHOT, 0, 50)
    file = camera.wait_file(30.0)
    assert file is not None
    assert file.size_bytes == len(library.content)
    to = tmp_path / "shot"
    camera.download(file, to)
    assert to.read_bytes() == library.content
    to.write_bytes(library.content[:1_234_567])
    camera.download(file, to)  # goes on from there
    assert to.read_bytes() == library.content
    assert file in camera.files()
    camera.delete(file)
    assert file not in camera.files()


def test_a_series_and_then_a_full_store(camera):
    """It has room for 26 captures over USB; the next one ends with the event that says so."""
    names = set()
    for _ in range(26):
        camera._session.call(Op.INITIATE_CAPTURE, 0, 0)
        names.add(camera.wait_file(30.0).name)
    assert len(names) == 26
    camera._session.call(Op.INITIATE_CAPTURE, 0, 0)
    with pytest.raises(DeviceRefused, match="card full"):
        camera.wait_file(30.0)


@pytest.mark.parametrize("teller", ["interrupt endpoint", "list"])
def test_each_way_of_telling_works_alone(library, monkeypatch, teller):
    backend = GphotoBackend(library.port)
    if teller == "list":
        monkeypatch.setattr(backend, "intr_read", lambda *_: _nothing())
    else:
        monkeypatch.setattr("labdrivers.ptp.watch.LIST_EVERY_S", 1e9)
    monkeypatch.setattr(camera_module, "load_backend", lambda *_, **__: backend)
    driver = PtpCamera("peer", {"serial": "0.1", "timeout_s": 2.0})
    driver.connect()
    driver._session.call(CABLE_SHOT, 0, 1)
    assert driver.wait_file(30.0) is not None
    driver.close()


def _nothing():
    time.sleep(0.05)
    raise USBTimeoutError("timed out", None, 110)
