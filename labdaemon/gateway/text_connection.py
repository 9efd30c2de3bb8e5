"""One connection of the text gateway: bytes in, lines in their turn, answers out, all of it bounded."""

from __future__ import annotations

import asyncio
import logging
import re
from contextlib import suppress

from labdaemon.errors import LabdaemonError
from labdaemon.gateway.client_state import ClientState, EndOfSession
from labdaemon.gateway.line_splitter import LineSplitter
from labdaemon.gateway.scpi_errors import ScpiError
from labdaemon.gateway.text_session import look_ahead, run_line
from labdaemon.stream.pace import Pace

BLOCK_BYTES = 4096
"""Read at a time: some microseconds of the event loop."""
MOST_LINES = 32
"""That wait for their turn; the client's further lines wait in its own system."""
READS_S = 10.0
"""A client that does not read its answers for so long loses its connection."""
LAST_S = 30.0
"""How long lines of a client that has closed its side are still carried out."""
WRITE_BYTES = 64 << 10
LINE_UNITS = 1.0
BYTES_A_UNIT = 1024

_BROWSER = re.compile(rb"[A-Z]+ \S+ HTTP/\d|(?i:host|content-length|user-agent|origin) ?:")
"""A browser or a scanner: a page of any site could otherwise post lines to this port."""

log: logging.Logger = logging.getLogger(__name__)


class ConnectionRefusal(Exception):
    """Why a connection ends that the client has not closed."""


class TextConnection:
    """A client's connection.

    Parameters
    ----------
    client
        What is known of the client.
    reader, writer
        Its streams.
    pace
        Shared by all connections.

    Attributes
    ----------
    active_s
        When its last line came, on the loop's clock.
    """

    def __init__(
        self, client: ClientState, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, pace: Pace
    ) -> None:
        self.client = client
        self._reader, self._writer, self._pace = reader, writer, pace
        self._lines: asyncio.Queue[bytes | ConnectionRefusal | None] = asyncio.Queue(MOST_LINES)
        self._splitter = LineSplitter()
        self.active_s: float = asyncio.get_running_loop().time()
        writer.transport.set_write_buffer_limits(WRITE_BYTES)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is being done for the client."""
        return self._lines.empty() and not self.client.is_waiting

    def abort(self) -> None:
        """End it at once, with what is still to be sent."""
        self._writer.transport.abort()

    async def run(self) -> None:
        """Serve until either side ends it.

        Raises
        ------
        ConnectionRefusal
            The client has lost it by what it sent, or did not read.
        """
        work = asyncio.create_task(self._work())
        read = asyncio.create_task(self._read())
        try:
            await asyncio.wait([work, read], return_when=asyncio.FIRST_COMPLETED)
            if not work.done():
                read.result()
                with suppress(TimeoutError):  # the client reads nothing, the reason for the end neither
                    async with asyncio.timeout(LAST_S):
                        await self._lines.put(ConnectionRefusal())
                        await asyncio.shield(work)
            if work.done():
                work.result()
        finally:
            work.cancel()
            read.cancel()
            await asyncio.gather(work, read, return_exceptions=True)
            self._writer.close()
            self._writer.transport.abort()

    async def _read(self) -> None:
        while True:
            try:
                data = await self._reader.read(BLOCK_BYTES)
            except OSError:  # it is gone without a word
                data = b""
            if not data:
                return
            lines = self._splitter.feed(data)
            if self._splitter.is_endless:
                raise ConnectionRefusal("bytes without an end of line")
            for line in lines:
                await self._take(line)
            await self._pace.take(LINE_UNITS * len(lines) + len(data) / BYTES_A_UNIT)

    async def _take(self, line: bytes | None) -> None:
        self.active_s = asyncio.get_running_loop().time()
        if line is not None and _BROWSER.match(line):
            raise ConnectionRefusal("a browser's request; this port speaks SCPI")
        if line is not None:
            look_ahead(self.client, line.decode("ascii", "replace"))
        self.client.new_line.set()
        await self._lines.put(line)

    async def _work(self) -> None:
        while True:
            line = await self._lines.get()
            if isinstance(line, ConnectionRefusal):
                await self._drain()
                return
            if self._lines.empty():
                self.client.new_line.clear()
            answer = await self._carry_out(line)
            if answer is not None:
                self._writer.write(answer + b"\n")
                await self._drain()

    async def _carry_out(self, line: bytes | None) -> bytes | None:
        if line is None:
            self.client.record(ScpiError(-363, "the line is too long"))
            return None
        try:
            text = line.decode()
        except UnicodeDecodeError:
            self.client.record(ScpiError(-101, "bytes that are no text"))
            return None
        try:
            return await run_line(self.client, text)
        except EndOfSession as exc:
            raise ConnectionRefusal(str(exc)) from None
        except LabdaemonError as exc:  # the journal cannot be read now
            self.client.record(ScpiError(-310, str(exc)))
            return None
        except Exception:  # a slip of ours: the client learns of it, and the next line is carried out
            log.exception("a line of the text gateway failed")
            self.client.record(ScpiError(-310, "see the daemon's log"))
            return None

    async def _drain(self) -> None:
        try:
            async with asyncio.timeout(READS_S):
                await self._writer.drain()
        except TimeoutError:
            raise ConnectionRefusal(f"it did not read its answers for {READS_S:g} s") from None
        except OSError:
            raise ConnectionRefusal("") from None  # it has left
