"""A simulated Nikon D80 at the level of PTP: operations in, responses and events out; its cable release apart.

A shot is fired at the release cable, takes its time, is rendered from the rig's motion and lands on the card; only
then does the host hear of it. The USB side (packets, stalls, endpoints) is `usb_device`.
"""

from __future__ import annotations

import random
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from labdrivers.ptp.codes import EventCode, Op, Prop, Response
from labdrivers.ptp.container import pack_string
from labdrivers.sim.faults import Faults
from labdrivers.sim.ptp_card import STORAGE_ID, CardObject, MemoryCard, MemoryCardFull
from labdrivers.sim.ptp_settings import BodySettings

FAULTS = {
    "no_shutter": "ignores its release cable",
    "card_full": "has no room for another file and says so",
    "no_card": "has no card: a cable shot fails silently",
    "low_battery": "reports `value` percent of battery (default 3)",
    "busy": "answers busy, for ever",
    "lost_event": "reports no new file, neither way",
    "no_interrupt": "reports new files only when asked",
    "no_get_event": "answers nothing to Nikon's GetEvent",
    "event_flood": "sends `value` property-change events (default 200) before each other event",
    "setting_ignored": "accepts a setting and does not take it",
    "setting_locked": "has its exposure settings read-only",
    "session_stuck": "refuses to open a session until it is reset",
    "already_open": "says that the session is open already",
    "no_partial": "does not know GetPartialObject",
    "short_partial": "sends half of what GetPartialObject asks",
    "file_vanishes": "says bad handle to every question about a file",
    "wrong_serial": "reports another serial number",
    "to_memory": "keeps its shots in memory, one at a time, as with the host as their medium",
    "slow_file": "takes `value` seconds longer to write a file (default 3)",
    "bad_dataset": "cuts its datasets short",
    "zero_size": "says 0 bytes the first `value` times (default 1) that it is asked about a file",
    "half_size": "announces a file `value` seconds (default 1) before it has written it, with half its size",
    "huge_size": "says 4 GB the first `value` times (default 1) that it is asked about a file",
    "empty_info": "describes a file with no data the first `value` times (default 1) that it is asked about it",
    "one_name": "gives every file the name DSC_0001, as after DSC_9999",
    "no_date": "gives its files no date",
    "clock_reset": "has a clock that stands at its reset value",
    "clock_shift": "has a clock that is `value` seconds ahead (default 3600)",
    "reuse_handles": "gives a new file the handle of the one that was deleted last",
    "companions": "writes a JPEG, a HEIF, a dust-off file, a note and a film of the same name with each shot",
    "broken_object": "has two foreign objects with the next shot: one's name is broken, the other's description",
    "deaf_while_busy": "ignores its release cable for `value` seconds (default 0.5) after it has sent part of a file",
}
OPERATIONS = (
    *range(0x1001, 0x1010), 0x1014, 0x1015, 0x1016, 0x101B, *range(0x90C0, 0x90CC), 0x9801, 0x9802, 0x9803, 0x9805,
)  # fmt: skip
EVENTS = (0x4002, 0x4003, 0x4006, 0x400A, 0x400C, 0x400D, 0xC101, 0xC102)
MODEL, MAKER, VERSION = "NIKON DSC D80", "Nikon Corporation", "V1.10"
MOST_EVENTS = 500
COMPANIONS = (
    (".JPG", 0x3801, b"\xff\xd8\xff\xe1" + bytes(3000)),
    (".HIF", 0xB110, b"\0\0\0\x1cftypheix\0\0\0\0mif1heic" + bytes(3000)),
    (".NDF", 0x3000, b"NDF\0" + bytes(range(256)) * 8),
    (".XMP", 0x3000, b"<x:xmpmeta xmlns:x='adobe:ns:meta/'>" + b" " * 500 + b"</x:xmpmeta>"),
    (".MOV", 0x300D, b"\0\0\0\x14ftypqt  \0\0\0\0qt  " + bytes(3000)),
)
"""What bodies write with the RAW file under the same stem: ending, format, content."""

EARLY_ANSWERS = {"zero_size": 0, "huge_size": 4_290_000_000, "empty_info": 0}
"""Sizes that bodies say before they have written a file."""

RESET_CLOCK = "20000101T000000"
BROKEN_NAME = "\ud800../..\x07/DSC\udfff"
RECOVERY_S = 0.1
"""From the closing of the shutter until it can be released again."""

Answer = tuple[int, tuple[int, ...], bytes | None]
"""Response code, its parameters, and the data phase before it, if any."""


class Exposer(Protocol):
    """The rig as one camera sees it."""

    lag_s: float

    def expose(self, opened_s: float, exposure_s: float, *, iso: int, f_number: float) -> bytes:
        """The file of an exposure that has ended; may take seconds."""
        ...


class PtpBody:
    """The body.

    Parameters
    ----------
    serial
        Its number.
    exposer
        What is before its lens.
    card
        Where its files go.
    clock
        The rig's clock.
    """

    def __init__(
        self,
        serial: str,
        exposer: Exposer,
        *,
        card: MemoryCard | None = None,
        settings: BodySettings | None = None,
        clock: Callable[[], float] = time.monotonic,
        lag_jitter_s: float = 2e-4,
    ) -> None:
        self.faults = Faults(FAULTS)
        self._serial, self._exposer, self._clock = serial, exposer, clock
        self.card = card or MemoryCard()
        self.settings = settings or BodySettings()
        self._random = random.Random(serial)
        self._jitter_s = lag_jitter_s
        self._lock = threading.RLock()
        self._session_open = False
        self._taken_over = False
        self._closed_at = 0.0
        self._sent_at = -1e9
        self._asked: dict[int, int] = {}
        self._broken: set[int] = set()
        self._told: deque[tuple[int, int]] = deque(maxlen=MOST_EVENTS)
        self.on_event: Callable[[int, int], None] = lambda code, parameter: None

    @property
    def serial(self) -> str:
        """As reported."""
        return "9999999" if self.faults.is_on("wrong_serial") else self._serial

    # -- the release cable ---------------------------------------------------------------------------------------

    def release(self, t: float) -> float | None:
        """The cable is pressed at `t`: when the shutter is open, None if the body does not fire."""
        with self._lock:
            if self._taken_over or t < self._closed_at + RECOVERY_S or self.faults.strike("no_shutter"):
                return None
            deaf_s = self.faults.value("deaf_while_busy", 0.5) if self.faults.is_on("deaf_while_busy") else 0.0
            if t < self._sent_at + deaf_s:
                return None
            opened = t + self._exposer.lag_s + self._random.uniform(-1, 1) * self._jitter_s
            exposure_s = self.settings.exposure_s
            self._closed_at = opened + exposure_s
            shot = (opened, exposure_s, self.settings.iso, self.settings.f_number)
        threading.Thread(target=self._take, args=shot, name=f"shot {self._serial}", daemon=True).start()
        return opened

    def _take(self, opened: float, exposure_s: float, iso: int, f_number: float) -> None:
        time.sleep(max(0.0, opened + exposure_s - self._clock()))
        stamp = self._stamp(time.time() - exposure_s)
        if self.faults.strike("no_card"):
            return
        content = self._exposer.expose(opened, exposure_s, iso=iso, f_number=f_number)
        if self.faults.is_on("slow_file"):
            delay = self.faults.value("slow_file", 3.0)
            self.faults.strike("slow_file")
            time.sleep(delay)
        if self.faults.is_on("to_memory"):
            self._tell(EventCode.NIKON_ADDED_IN_SDRAM, self.card.hold(content, stamp))
            return
        try:
            if self.faults.strike("card_full"):
                raise MemoryCardFull
            new = self._write(content, stamp)
        except MemoryCardFull:
            self._tell(EventCode.STORE_FULL, STORAGE_ID)
            return
        if self.faults.strike("lost_event"):
            return
        for handle in new:
            self._tell(EventCode.OBJECT_ADDED, handle)

    def _stamp(self, at: float) -> str:
        """The body's own time at a wall-clock time, as it writes it."""
        if self.faults.is_on("no_date"):
            return ""
        if self.faults.is_on("clock_reset"):
            return RESET_CLOCK
        ahead_s = self.faults.value("clock_shift", 3600.0) if self.faults.is_on("clock_shift") else 0.0
        return time.strftime("%Y%m%dT%H%M%S", time.localtime(at + ahead_s))

    def _write(self, content: bytes, stamp: str) -> list[int]:
        """Put a shot on the card, with what the body writes along; handles in the order of their announcement."""
        reuse = self.faults.is_on("reuse_handles")
        name = "DSC_0001.DNG" if self.faults.is_on("one_name") else None
        new = self.card.add(content, stamp, name=name, reuse_handle=reuse)
        shot = self.card.get(new[-1])
        if self.faults.is_on("companions") and shot is not None:
            stem = shot.name.rpartition(".")[0]
            for ending, form, data in COMPANIONS:
                new[-1:] = [*self.card.add(data, stamp, name=stem + ending, form=form), new[-1]]
        if self.faults.strike("broken_object"):
            named = self.card.add(b"nothing of a camera's", "", name=BROKEN_NAME)
            cut = self.card.add(b"nothing of a camera's", "", name="X")
            self._broken.update(cut)
            new += named + cut
        return new

    def _tell(self, code: int, parameter: int) -> None:
        if self.faults.is_on("event_flood"):
            count = int(self.faults.value("event_flood", 200))
            self.faults.strike("event_flood")
            for _ in range(count):
                self._emit(EventCode.PROP_CHANGED, Prop.EXPOSURE_TIME)
        self._emit(code, parameter)

    def _emit(self, code: int, parameter: int) -> None:
        with self._lock:
            self._told.append((code, parameter))
        if not self.faults.is_on("no_interrupt"):
            self.on_event(code, parameter)

    # -- PTP -----------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Class request RESET."""
        self.faults.clear("session_stuck")
        self._session_open = False
        self._taken_over = False

    def unplugged(self) -> None:
        """The cable was pulled: the session is gone, the card stays."""
        self._session_open = False
        self._taken_over = False
        self._told.clear()

    def operate(self, code: int, parameters: tuple[int, ...], data: bytes) -> Answer:
        """One transaction."""
        first = parameters[0] if parameters else 0
        if code not in OPERATIONS:
            return Response.NOT_SUPPORTED, (), None
        if code == Op.OPEN_SESSION:
            return self._open_session(), (), None
        if code == Op.GET_DEVICE_INFO:
            return self._ok(self._device_info())
        if not self._session_open:
            return Response.SESSION_NOT_OPEN, (), None
        if self.faults.strike("busy") or (code != Op.CLOSE_SESSION and self._clock() < self._closed_at):
            return Response.BUSY, (), None  # a body that exposes has no time for the host
        match code:
            case Op.CLOSE_SESSION:
                self._session_open = False
                return self._ok()
            case Op.GET_STORAGE_IDS:
                return self._ok(struct.pack("<II", 1, STORAGE_ID))
            case Op.GET_STORAGE_INFO:
                return self._storage_info(first)
            case Op.GET_OBJECT_HANDLES:
                handles = self.card.handles()
                return self._ok(struct.pack(f"<I{len(handles)}I", len(handles), *handles))
            case Op.GET_OBJECT_INFO | Op.GET_OBJECT | Op.GET_PARTIAL_OBJECT | Op.DELETE_OBJECT:
                return self._object(code, parameters)
            case Op.GET_PROP_DESC | Op.GET_PROP_VALUE | Op.SET_PROP_VALUE:
                return self._property(code, first, data)
            case Op.NIKON_TAKE_OVER:
                self._taken_over = first == 1
                return self._ok()
            case Op.NIKON_GET_EVENT:
                return self._ok(self._events())
            case Op.NIKON_DEVICE_READY:
                return self._ok()
            case Op.INITIATE_CAPTURE:
                return self._capture()
        return Response.NOT_SUPPORTED, (), None

    def _ok(self, data: bytes | None = None) -> Answer:
        if data and self.faults.strike("bad_dataset"):
            data = data[: len(data) // 2]
        return Response.OK, (), data

    def _open_session(self) -> int:
        if self.faults.is_on("session_stuck"):
            return Response.GENERAL_ERROR
        if self.faults.strike("already_open"):
            self._session_open = True
        if self._session_open:
            return Response.ALREADY_OPEN
        self._session_open = True
        return Response.OK

    def _capture(self) -> Answer:
        """A capture over USB: the body works on its own and reports back."""
        opened = self.release(self._clock())
        return self._ok() if opened is not None else (Response.BUSY, (), None)

    def _device_info(self) -> bytes:
        def array(values: tuple[int, ...] | list[int]) -> bytes:
            return struct.pack(f"<I{len(values)}H", len(values), *values)

        operations = [op for op in OPERATIONS if not (op == Op.GET_PARTIAL_OBJECT and self.faults.is_on("no_partial"))]
        head = struct.pack("<HIH", 100, 0x0A, 100) + pack_string("") + struct.pack("<H", 0)
        arrays = array(operations) + array(EVENTS) + array(self.settings.codes()) + array([]) + array([0x3000, 0x3801])
        return head + arrays + b"".join(map(pack_string, (MAKER, MODEL, VERSION, self.serial)))

    def _storage_info(self, storage: int) -> Answer:
        if storage != STORAGE_ID:
            return Response.BAD_STORAGE, (), None
        free = 0 if self.faults.is_on("card_full") else self.card.free_bytes()
        numbers = struct.pack("<HHHQQI", 4, 3, 0, self.card.capacity_bytes, free, 0xFFFFFFFF)
        return self._ok(numbers + pack_string("NIKON D80") + pack_string(""))

    def _object(self, code: int, parameters: tuple[int, ...]) -> Answer:
        item = self.card.get(parameters[0] if parameters else 0)
        if item is None or self.faults.strike("file_vanishes"):
            return Response.BAD_HANDLE, (), None
        if code == Op.GET_OBJECT_INFO:
            return self._ok(self._describe(item))
        if code == Op.DELETE_OBJECT:
            self.card.delete(item.handle)
            self._asked.pop(item.handle, None)
            return self._ok()
        self._sent_at = self._clock()
        if code == Op.GET_OBJECT:
            return Response.OK, (), self.card.read(item, 0, item.size_bytes)
        if self.faults.is_on("no_partial"):
            return Response.NOT_SUPPORTED, (), None
        if len(parameters) < 3:
            return Response.BAD_PARAMETER, (), None
        size = max(1, parameters[2] // 2) if self.faults.strike("short_partial") else parameters[2]
        block = self.card.read(item, parameters[1], min(size, max(self._size_now(item) - parameters[1], 0)))
        return Response.OK, (len(block),), block

    def _describe(self, item: CardObject) -> bytes:
        """GetObjectInfo's dataset, as far as the body has it right."""
        if item.handle in self._broken:
            return _object_info(item, item.size_bytes)[:60]
        asked = self._asked[item.handle] = self._asked.get(item.handle, 0) + 1
        if item.path is None:
            return _object_info(item, 0)
        wrong = [name for name in EARLY_ANSWERS if self.faults.is_on(name) and asked <= self.faults.value(name, 1.0)]
        if "empty_info" in wrong:
            return b""
        return _object_info(item, EARLY_ANSWERS[wrong[0]] if wrong else self._size_now(item))

    def _size_now(self, item: CardObject) -> int:
        """How much of a file is written by now."""
        early_s = self.faults.value("half_size", 1.0) if self.faults.is_on("half_size") else 0.0
        is_early = item.path is not None and time.monotonic() < item.added_s + early_s
        return item.size_bytes // 2 if is_early else item.size_bytes

    def _property(self, code: int, which: int, data: bytes) -> Answer:
        setting = self.settings.get(which)
        if setting is None:
            return Response.PROPERTY_NOT_SUPPORTED, (), None
        if which == Prop.BATTERY:
            setting.value = int(self.faults.value("low_battery", 3)) if self.faults.is_on("low_battery") else 90
        locked = self.faults.is_on("setting_locked") and which != Prop.BATTERY
        if code == Op.GET_PROP_DESC:
            return self._ok(self.settings.describe(which, read_only=locked))
        if code == Op.GET_PROP_VALUE:
            return self._ok(setting.pack())
        if locked or not setting.writable():
            return Response.ACCESS_DENIED, (), None
        if len(data) != len(setting.pack()):
            return Response.BAD_PROPERTY_VALUE, (), None
        if self.faults.strike("setting_ignored"):
            return self._ok()
        value = int.from_bytes(data, "little")
        return self._ok() if self.settings.set(which, value) else (Response.BAD_PROPERTY_VALUE, (), None)

    def _events(self) -> bytes:
        if self.faults.is_on("no_get_event"):
            return struct.pack("<H", 0)
        with self._lock:
            reported = list(self._told)
            self._told.clear()
        return struct.pack("<H", len(reported)) + b"".join(struct.pack("<HI", *event) for event in reported)


def _object_info(item: CardObject, size_bytes: int) -> bytes:
    association = 1 if item.path is None else 0
    head = struct.pack("<IHHI", STORAGE_ID, item.format, 0, size_bytes)
    middle = struct.pack("<HIIIIIIIHII", 0, 0, 0, 0, 3872, 2592, 12, item.parent, association, 0, 0)
    name = (item.name + "\0").encode("utf-16-le", "surrogatepass")  # a broken one is sent as it is
    strings = map(pack_string, (item.captured_at, item.captured_at, ""))
    return head + middle + bytes([len(name) // 2]) + name + b"".join(strings)
