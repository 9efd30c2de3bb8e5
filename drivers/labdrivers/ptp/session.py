"""One conversation with a camera: transactions in order, busy answers waited out, broken ones cleared up.

PTP does nothing twice by itself and numbers every transaction, so a reply is this one's only if it carries its number;
older ones that a cancelled transfer left behind are skipped.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass

from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError
from labdrivers.ptp.codes import MEANINGS, ContainerKind, Op, Response
from labdrivers.ptp.container import BadContainer, pack, pack_parameters, unpack_parameters
from labdrivers.ptp.datasets import DeviceInfo
from labdrivers.ptp.transport import UsbPipe

SESSION_ID = 1  # any number but 0, by the standard
BUSY_POLL_S = 0.1  # bodies that write a file answer "busy" for a second
STALE_CONTAINERS = 8  # answers to calls that were given up; more is no camera's protocol


@dataclass(frozen=True, slots=True)
class PtpReply:
    """What came back of a transaction."""

    code: int
    parameters: tuple[int, ...]
    data: bytes


class PtpRefused(DeviceRefused):
    """A response other than OK.

    Attributes
    ----------
    code
        The response code.
    """

    def __init__(self, message: str, *, device: str, code: int) -> None:
        self.code = code
        super().__init__(message, device=device)


class PtpSession:
    """Transactions over a `UsbPipe`, one at a time, whichever thread asks.

    Parameters
    ----------
    pipe
        The claimed interface.
    timeout_s
        Deadline of a transaction; while the camera says busy it may take this long again.
    """

    def __init__(self, pipe: UsbPipe, *, timeout_s: float) -> None:
        self._pipe, self._timeout_s = pipe, timeout_s
        self._lock = threading.RLock()
        self._next_transaction = 0
        self._open = False
        self._info: DeviceInfo | None = None

    @property
    def device(self) -> str:
        """The camera's name in the rig file."""
        return self._pipe.device

    @property
    def info(self) -> DeviceInfo:
        """Who the camera is and what it can do; asked once."""
        if self._info is None:
            try:
                self._info = DeviceInfo.parse(self.call(Op.GET_DEVICE_INFO).data)
            except BadContainer as exc:
                raise ProtocolError(
                    f"describes itself in a way that makes no sense ({exc})", device=self.device
                ) from exc
        return self._info

    def supports(self, operation: int) -> bool:
        """Whether the camera lists this operation."""
        return operation in self.info.operations

    def open(self) -> None:
        """Open the session; a camera that still has one from before is taken as it is, one that fails is reset."""
        with self._lock:
            for last in (False, True):
                self._next_transaction = 0
                try:
                    reply = self._transact(Op.OPEN_SESSION, (SESSION_ID,), None, self._timeout_s)
                    if reply.code in (Response.OK, Response.ALREADY_OPEN):
                        self._open = True
                        return
                    fault: DeviceError = self._refusal(Op.OPEN_SESSION, reply.code)
                except (TransportError, ProtocolError) as exc:
                    fault = exc
                if not last:
                    self._pipe.reset(self._timeout_s)
            raise fault

    def close(self) -> None:
        """Close the session, without insisting."""
        with self._lock:
            if self._open:
                self._open = False
                with suppress(DeviceError):  # the camera is gone, or forgets its session by itself
                    self._transact(Op.CLOSE_SESSION, (), None, min(self._timeout_s, 2.0))

    def call(
        self, operation: int, *parameters: int, data_out: bytes | None = None, patience_s: float = 0.0
    ) -> PtpReply:
        """One transaction that must end with OK; a busy camera is waited for.

        Parameters
        ----------
        operation, parameters
            What to do.
        data_out
            Data phase towards the camera.
        patience_s
            How much longer than the deadline a camera may say busy (while it exposes, for one).

        Raises
        ------
        PtpRefused
            Any other response.
        TransportError, ProtocolError
            The wire or the answer failed; the transaction was cancelled.
        """
        patience_s += self._timeout_s
        deadline = time.monotonic() + patience_s
        while True:
            with self._lock:
                reply = self._transact(operation, parameters, data_out, self._timeout_s)
            if reply.code == Response.OK:
                return reply
            if reply.code != Response.BUSY:
                raise self._refusal(operation, reply.code)
            if time.monotonic() >= deadline:
                raise TransportError(
                    f"stays busy for {patience_s:.3g} s (a low battery looks like this too); check its battery, "
                    "or switch it off and on",
                    device=self.device,
                )
            self._wait_ready(deadline)

    def _wait_ready(self, deadline: float) -> None:
        time.sleep(BUSY_POLL_S)
        if self._info is None or not self.supports(Op.NIKON_DEVICE_READY):
            return
        while time.monotonic() < deadline:
            with self._lock:
                reply = self._transact(Op.NIKON_DEVICE_READY, (), None, self._timeout_s)
            if reply.code != Response.BUSY:
                return
            time.sleep(BUSY_POLL_S)

    def _transact(
        self, operation: int, parameters: tuple[int, ...], data_out: bytes | None, timeout_s: float
    ) -> PtpReply:
        transaction = self._next_transaction
        self._next_transaction = (transaction + 1) % 0xFFFFFFFF
        deadline = time.monotonic() + timeout_s
        try:
            self._pipe.send(
                pack(ContainerKind.COMMAND, operation, transaction, pack_parameters(*parameters)), timeout_s
            )
            if data_out is not None:
                self._pipe.send(pack(ContainerKind.DATA, operation, transaction, data_out), timeout_s)
            return self._answer(operation, transaction, deadline)
        except (TransportError, ProtocolError):
            with suppress(DeviceError):  # the first fault is the one to report
                self._pipe.cancel(transaction, min(timeout_s, 2.0))
            raise

    def _answer(self, operation: int, transaction: int, deadline: float) -> PtpReply:
        data = b""
        for count in range(STALE_CONTAINERS):
            header, payload = self._pipe.receive(deadline, first=count == 0)
            if header.transaction != transaction or (header.kind == ContainerKind.DATA and header.code != operation):
                continue  # left over from a transaction that was given up
            if header.kind == ContainerKind.DATA:
                data = payload
            elif header.kind == ContainerKind.RESPONSE:
                return PtpReply(header.code, unpack_parameters(payload), data)
        raise ProtocolError("answers other transactions than the one asked; reset the camera", device=self.device)

    def _refusal(self, operation: int, code: int) -> PtpRefused:
        name = next((op.name.lower() for op in Op if op == operation), f"{operation:#06x}")
        meaning = MEANINGS.get(code, "refused")
        return PtpRefused(f"{meaning} ({code:#06x} to {name})", device=self.device, code=code)
