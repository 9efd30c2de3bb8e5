"""What a camera reports unasked: whole events are kept, floods and rubbish never delay a file."""

from __future__ import annotations

import struct
import threading
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DeviceError, TransportError
from labdrivers.ptp.codes import ContainerKind, EventCode
from labdrivers.ptp.container import pack, pack_parameters
from labdrivers.ptp.events import EventListener, parse_nikon_events


class FakePipe:
    """An interrupt endpoint with packets to read; then nothing, or an error."""

    device = "left"

    def __init__(self, *packets: bytes, error: Exception | None = None) -> None:
        self._packets, self._error = deque(packets), error
        self.is_empty = threading.Event()

    def read_interrupt(self, timeout_s: float) -> bytes | None:
        if self._packets:
            return self._packets.popleft()
        self.is_empty.set()
        if self._error is not None:
            raise self._error
        threading.Event().wait(min(timeout_s, 0.001))
        return None


def event(code: int, *parameters: int) -> bytes:
    return pack(ContainerKind.EVENT, code, 7, pack_parameters(*parameters))


def heard(pipe: FakePipe) -> list[tuple[int, int]]:
    """What a listener has kept once all packets are read."""
    listener = EventListener(pipe)  # type: ignore[arg-type]
    listener.start()
    assert pipe.is_empty.wait(30.0)
    listener.close()
    found = []
    while (one := listener.next(0.0)) is not None:
        found.append(one)
    return found


ADDED = EventCode.OBJECT_ADDED


def test_news_of_files_is_kept_in_order() -> None:
    assert heard(FakePipe(event(ADDED, 1), event(ADDED, 2) + event(EventCode.OBJECT_REMOVED, 1))) == [
        (ADDED, 1), (ADDED, 2), (EventCode.OBJECT_REMOVED, 1),
    ]  # fmt: skip


def test_an_event_may_come_in_pieces() -> None:
    whole = event(ADDED, 9)
    assert heard(FakePipe(whole[:5], whole[5:13], whole[13:])) == [(ADDED, 9)]


def test_a_flood_of_property_changes_is_dropped() -> None:
    flood = [event(0x4006, number) for number in range(500)]
    assert heard(FakePipe(*flood, event(ADDED, 3))) == [(ADDED, 3)]


@pytest.mark.parametrize(
    "rubbish", [b"\xff" * 12, b"\0" * 24, pack(2, ADDED, 1), pack(ContainerKind.EVENT, ADDED, 1, b"\0" * 80)]
)
def test_after_rubbish_the_next_packet_is_read_anew(rubbish: bytes) -> None:
    assert heard(FakePipe(rubbish, event(ADDED, 4)))[-1:] == [(ADDED, 4)]


@pytest.mark.parametrize("error", [TransportError("gone", device="left"), RuntimeError("a backend's own")])
def test_a_lost_camera_is_a_fault_not_a_dead_thread(error: Exception) -> None:
    pipe = FakePipe(event(ADDED, 1), error=error)
    listener = EventListener(pipe)  # type: ignore[arg-type]
    listener.start()
    assert pipe.is_empty.wait(30.0)
    listener.close()
    assert listener.next(0.0) == (ADDED, 1)
    assert isinstance(listener.fault, DeviceError)
    assert listener.fault.device == "left"


def test_waiting_ends_in_time() -> None:
    listener = EventListener(FakePipe())  # type: ignore[arg-type]
    assert listener.next(0.01) is None
    listener.close()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF)), max_size=10), st.integers(0, 70))
def test_nikons_list_is_read_as_far_as_it_is_whole(events: list[tuple[int, int]], cut: int) -> None:
    data = struct.pack("<H", len(events)) + b"".join(struct.pack("<HI", *one) for one in events)
    whole = max(len(data[: len(data) - cut]) - 2, 0) // 6 if len(data) - cut >= 2 else 0
    assert parse_nikon_events(data[: max(len(data) - cut, 0)]) == events[:whole]
