"""A camera's pipe that another thread closes: what waits in it ends with the device's error, and it stays closed."""

from __future__ import annotations

import time

import pytest

from labdaemon.errors import TransportError


@pytest.mark.parametrize("call", ["send", "receive", "read_interrupt", "cancel", "reset"])
def test_a_pipe_that_was_closed_claims_nothing_anew(make_camera, call):
    """pyusb opens and claims by itself for each transfer: a call given up would keep the next connection out."""
    first = make_camera()
    pipe = first._pipe
    first.close()
    calls = {
        "send": lambda: pipe.send(bytes(12), 0.1),
        "receive": lambda: pipe.receive(time.monotonic() + 0.1),
        "read_interrupt": lambda: pipe.read_interrupt(0.1),
        "cancel": lambda: pipe.cancel(1, 0.1),
        "reset": lambda: pipe.reset(0.1),
    }
    with pytest.raises(TransportError, match="left: connection was closed by another call; connect again"):
        calls[call]()
    make_camera()  # "held by another program" otherwise


@pytest.mark.parametrize(
    "error", [AttributeError("'NoneType' has no handle"), ValueError("Invalid endpoint"), KeyError(0)]
)
def test_what_pyusb_raises_when_it_is_closed_in_mid_call_is_a_lost_connection(make_camera, monkeypatch, error):
    pipe = make_camera()._pipe

    def read(*_: object) -> bytes:
        pipe.close()
        raise error

    monkeypatch.setattr(pipe._in, "read", read)
    with pytest.raises(TransportError, match="left: connection lost while answering"):
        pipe.receive(time.monotonic() + 0.1)
    make_camera()


def test_a_transfer_that_opens_the_device_again_after_the_close_gives_it_back(make_camera, monkeypatch):
    camera = make_camera()
    pipe, real = camera._pipe, camera._pipe._in.read

    def read(size: int, timeout_ms: int) -> bytes:
        pipe.close()  # by another thread, between this one's look and its transfer
        return bytes(real(size, timeout_ms))

    monkeypatch.setattr(pipe._in, "read", read)
    with pytest.raises(TransportError):
        pipe.receive(time.monotonic() + 0.1)
    make_camera()


def test_a_camera_that_is_closed_between_two_looks_is_not_connected(camera):
    """The session is there still, and what watches for files is gone already."""
    camera._watch = None
    for call in (camera.files, lambda: camera.wait_file(0.1)):
        with pytest.raises(TransportError, match="not connected"):
            call()
