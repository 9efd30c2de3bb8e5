"""What a camera reports unasked: read on a thread of its own, because some bodies answer nothing else until it is read.

Only news of files is kept. Floods of property changes are read and dropped, so that they never delay a file.
"""

from __future__ import annotations

import queue
import struct
import threading

from labdaemon.errors import DeviceError, TransportError
from labdrivers.ptp.codes import ContainerKind, EventCode
from labdrivers.ptp.container import BadContainer, read_header, unpack_parameters
from labdrivers.ptp.transport import UsbPipe

NEWS = frozenset(
    {EventCode.OBJECT_ADDED, EventCode.OBJECT_REMOVED, EventCode.NIKON_ADDED_IN_SDRAM, EventCode.STORE_FULL}
)
LISTEN_S = 0.1  # so long at most does closing wait for the reading thread


class EventListener:
    """Drains the interrupt endpoint until closed or until the camera is gone.

    Parameters
    ----------
    pipe
        The claimed interface.
    """

    def __init__(self, pipe: UsbPipe) -> None:
        self._pipe, self._device = pipe, pipe.device
        self._news: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, name=f"{pipe.device} events", daemon=True)
        self.fault: DeviceError | None = None

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """Stop listening, within a fraction of a second."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(4 * LISTEN_S)

    def next(self, timeout_s: float) -> tuple[int, int] | None:
        """Next event about a file as (code, first parameter); None when none came in time."""
        try:
            return self._news.get(timeout=timeout_s) if timeout_s > 0 else self._news.get_nowait()
        except queue.Empty:  # none came in time
            return None

    def _listen(self) -> None:
        data = bytearray()
        while not self._stop.is_set():
            try:
                packet = self._pipe.read_interrupt(LISTEN_S)
            except DeviceError as exc:
                self.fault = exc
                return
            except Exception as exc:  # pyusb and its backends raise what they like; a dead thread would report no file
                self.fault = TransportError(f"cannot be listened to ({type(exc).__name__}: {exc})", device=self._device)
                return
            if packet is None:
                continue
            data += packet
            data = self._take(data)

    def _take(self, data: bytearray) -> bytearray:
        """Queue the whole events in `data`, return what is left of it."""
        while len(data) >= 12:
            try:
                header = read_header(data)
            except BadContainer:
                return bytearray()  # out of step: wait for the next packet, which starts an event
            if header.kind != ContainerKind.EVENT or header.length > 64:
                return bytearray()
            if len(data) < header.length:
                return data
            parameters = unpack_parameters(bytes(data[12 : header.length]))
            if header.code in NEWS:
                self._news.put((header.code, parameters[0] if parameters else 0))
            data = data[header.length :]
        return data


def parse_nikon_events(data: bytes) -> list[tuple[int, int]]:
    """Answer to Nikon's GetEvent: u16 count, then (u16 code, u32 parameter) each; what is cut off is left out."""
    if len(data) < 2:
        return []
    (count,) = struct.unpack_from("<H", data)
    whole = min(count, (len(data) - 2) // 6)
    return [struct.unpack_from("<HI", data, 2 + 6 * index) for index in range(whole)]
