"""The USB side of a simulated camera: a still-image interface with bulk, interrupt and control endpoints.

Bulk IN is a queue of transfers, each ended by a short packet (or a zero-length one where its size is a multiple of the
packet size), never a byte stream: a read that asks for too little, or for more than a transfer holds, gets what
real hardware would give it.
"""

from __future__ import annotations

import errno
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass

from labdrivers.ptp.codes import ContainerKind, Op
from labdrivers.ptp.container import HEADER, UNKNOWN_LENGTH, BadContainer, pack, pack_parameters, read_header
from labdrivers.sim.faults import Faults
from labdrivers.sim.ptp_device import PtpBody

EP_IN, EP_OUT, EP_INTERRUPT = 0x81, 0x02, 0x83
PACKET, INTERRUPT_PACKET = 512, 24
VENDOR, PRODUCT = 0x04B0, 0x0412
FAULTS = {
    "silent": "answers nothing on bulk IN",
    "late": "answers `value` seconds late (default 15)",
    "rubbish": "answers bytes that are no container",
    "wrong_transaction": "answers under another transaction's number",
    "stall": "stalls bulk IN before answering",
    "stall_out": "stalls bulk OUT",
    "pipe_error": "breaks a data phase in its middle with a pipe error",
    "cut_data": "breaks a data phase in its middle and goes silent",
    "late_zlp": "sends an empty packet before answering",
    "no_zlp": "ends no transfer with an empty packet, so a response may be glued to its data",
    "split_header": "sends each data phase's header as a transfer of its own",
    "unknown_length": "announces data phases as FFFFFFFF long",
    "interrupt_first": "answers bulk only once its pending events were read",
    "stale_answer": "first repeats the answer of an earlier transaction",
}


class UsbFault(Exception):
    """What the host's controller reports; `number` is the errno."""

    def __init__(self, number: int, text: str) -> None:
        self.number = number
        super().__init__(text)


@dataclass(slots=True)
class _Transfer:
    data: bytes
    ready_s: float
    at: int = 0
    breaks: bool = False


class UsbCamera:
    """A `PtpBody` on a USB cable.

    Parameters
    ----------
    body
        The camera behind the connector.
    """

    def __init__(self, body: PtpBody) -> None:
        self.body = body
        self.faults = Faults(FAULTS)
        self._news = threading.Condition()
        self._bulk_in: deque[_Transfer] = deque()
        self._interrupts: deque[bytes] = deque(maxlen=64)
        self._halted: set[int] = set()
        self._out = bytearray()
        self._command: tuple[int, int, tuple[int, ...]] | None = None
        self._last_answer = b""
        body.on_event = self._event

    def unplugged(self) -> None:
        """The cable was pulled: every transfer in progress is lost."""
        with self._news:
            self._bulk_in.clear()
            self._interrupts.clear()
            self._halted.clear()
            self._out.clear()
            self._command = None
            self._news.notify_all()
        self.body.unplugged()

    def clear_halt(self, endpoint: int) -> None:
        """CLEAR_FEATURE(ENDPOINT_HALT)."""
        with self._news:
            self._halted.discard(endpoint)

    def control(self, request_type: int, request: int, data: bytes, length: int) -> bytes:
        """Class requests of the still-image class; standard requests are the bus's."""
        if request_type == 0x21 and request == 0x64:
            with self._news:
                self._bulk_in.clear()
                self._out.clear()
                self._command = None
            return b""
        if request_type == 0x21 and request == 0x66:
            self.unplugged()
            self.body.reset()
            return b""
        if request_type == 0xA1 and request == 0x67:
            return struct.pack("<HH", 4, 0x2001)[:length]
        raise UsbFault(errno.EPIPE, "request not supported")

    # -- host to device ------------------------------------------------------------------------------------------

    def write(self, endpoint: int, data: bytes) -> int:
        """One bulk OUT transfer."""
        if endpoint != EP_OUT:
            raise UsbFault(errno.EINVAL, "no such endpoint")
        if self.faults.strike("stall_out"):
            self._halted.add(EP_OUT)
        if EP_OUT in self._halted:
            raise UsbFault(errno.EPIPE, "Pipe error")
        self._out += data
        if len(data) % PACKET == 0 and data:
            return len(data)  # not ended: more packets, or an empty one, must follow
        container, self._out = bytes(self._out), bytearray()
        if container:
            self._take(container)
        return len(data)

    def _take(self, container: bytes) -> None:
        try:
            header = read_header(container)
        except BadContainer:
            self._halted.update((EP_IN, EP_OUT))
            return
        payload = container[HEADER.size :]
        if header.kind == ContainerKind.COMMAND:
            parameters = struct.unpack(f"<{len(payload) // 4}I", payload[: len(payload) // 4 * 4])
            if header.code == Op.SET_PROP_VALUE:
                self._command = (header.code, header.transaction, parameters)
            else:
                self._answer(header.code, header.transaction, parameters, b"")
        elif header.kind == ContainerKind.DATA and self._command is not None:
            code, transaction, parameters = self._command
            self._command = None
            self._answer(code, transaction, parameters, payload)

    def _answer(self, code: int, transaction: int, parameters: tuple[int, ...], data_out: bytes) -> None:
        response, values, data = self.body.operate(code, parameters, data_out)
        if self.faults.strike("silent"):
            return
        if self.faults.strike("rubbish"):
            self._queue(b"\xde\xad\xbe\xef" * 5)
            return
        if self.faults.strike("wrong_transaction"):
            transaction += 1000
        if self.faults.strike("stall"):
            self._halted.add(EP_IN)
        if self.faults.strike("late_zlp"):
            self._queue(b"")
        if self._last_answer and self.faults.strike("stale_answer"):
            self._queue(self._last_answer)
        if data is not None and not self._data_phase(code, transaction, data):
            return
        self._last_answer = pack(ContainerKind.RESPONSE, response, transaction, pack_parameters(*values))
        self._queue(self._last_answer)

    def _data_phase(self, code: int, transaction: int, data: bytes) -> bool:
        """Queue the data phase; False if it was broken."""
        whole = pack(ContainerKind.DATA, code, transaction, data)
        if self.faults.is_on("unknown_length"):
            whole = HEADER.pack(UNKNOWN_LENGTH, ContainerKind.DATA, code, transaction) + data
        if self.faults.strike("pipe_error"):
            self._queue(whole[: max(PACKET, len(whole) // 2 // PACKET * PACKET)], breaks=True)
            return False
        if self.faults.strike("cut_data"):
            self._queue(whole[: len(whole) // 2 // PACKET * PACKET])
            return False
        if self.faults.is_on("split_header"):
            self._queue(whole[: HEADER.size])
            whole = whole[HEADER.size :]
        if whole:
            self._queue(whole)
        return True

    def _queue(self, data: bytes, *, breaks: bool = False) -> None:
        ready = time.monotonic()
        if self.faults.is_on("late"):
            ready += self.faults.value("late", 15.0)
            self.faults.strike("late")
        with self._news:
            self._bulk_in.append(_Transfer(data, ready, breaks=breaks))
            self._news.notify_all()

    # -- device to host ------------------------------------------------------------------------------------------

    def read(self, endpoint: int, size: int, timeout_ms: int) -> bytes:
        """One IN transfer into a buffer of `size` bytes."""
        deadline = time.monotonic() + timeout_ms / 1000
        if endpoint == EP_INTERRUPT:
            return self._read_interrupt(size, deadline)
        if endpoint != EP_IN:
            raise UsbFault(errno.EINVAL, "no such endpoint")
        got = bytearray()
        with self._news:
            while True:
                transfer = self._wait_transfer(deadline, bool(got))
                if transfer is None:
                    return bytes(got)
                piece = transfer.data[transfer.at : transfer.at + size - len(got)]
                left = len(transfer.data) - transfer.at
                if len(piece) < min(left, PACKET):
                    raise UsbFault(errno.EOVERFLOW, "Overflow")
                got += piece
                transfer.at += len(piece)
                if transfer.at < len(transfer.data):
                    return bytes(got)
                full_packets = len(transfer.data) % PACKET == 0 and len(transfer.data) > 0
                if transfer.breaks:
                    self._bulk_in.popleft()
                    self._halted.add(EP_IN)
                    return bytes(got)
                if full_packets and len(got) == size and not self.faults.is_on("no_zlp"):
                    # the buffer was full just before the empty packet, which is next
                    transfer.data, transfer.at = b"", 0
                    return bytes(got)
                self._bulk_in.popleft()
                if not full_packets or not self.faults.is_on("no_zlp") or len(got) == size:
                    return bytes(got)

    def _wait_transfer(self, deadline: float, started: bool) -> _Transfer | None:
        """Next transfer that is ready; None when time is up but something was read already."""
        while True:
            if EP_IN in self._halted:
                raise UsbFault(errno.EPIPE, "Pipe error")
            now = time.monotonic()
            held = self.faults.is_on("interrupt_first") and bool(self._interrupts)
            if self._bulk_in and self._bulk_in[0].ready_s <= now and not held:
                return self._bulk_in[0]
            if now >= deadline:
                if started:
                    return None
                raise UsbFault(errno.ETIMEDOUT, "Operation timed out")
            until = min(deadline, self._bulk_in[0].ready_s) if self._bulk_in and not held else deadline
            self._news.wait(max(0.001, until - now))

    def _read_interrupt(self, size: int, deadline: float) -> bytes:
        with self._news:
            while not self._interrupts:
                left = deadline - time.monotonic()
                if left <= 0:
                    raise UsbFault(errno.ETIMEDOUT, "Operation timed out")
                self._news.wait(left)
            packet = self._interrupts.popleft()
            self._news.notify_all()
        if len(packet) > size:
            raise UsbFault(errno.EOVERFLOW, "Overflow")
        return packet

    def _event(self, code: int, parameter: int) -> None:
        event = pack(ContainerKind.EVENT, code, 0xFFFFFFFF, pack_parameters(parameter))
        with self._news:
            self._interrupts.append(event)
            self._news.notify_all()
