"""Bytes of a client to lines: bounded, whatever the client sends."""

from __future__ import annotations

LONGEST_LINE = 4096
"""Bytes."""
MOST_WITHOUT_END = 1 << 20
"""Bytes without an end of line after which the peer is none of ours."""


class LineSplitter:
    """Collects bytes until a line ends; what is beyond `LONGEST_LINE` is dropped up to the next end of line.

    A line ends with LF, CR LF or CR: terminals and older VISA programs send CR alone, and would wait for ever.
    """

    def __init__(self) -> None:
        self._line = bytearray()
        self._dropped = 0
        self._is_after_cr = False

    @property
    def is_endless(self) -> bool:
        """Whether so much came without an end of line that no end is to be expected."""
        return self._dropped > MOST_WITHOUT_END

    def feed(self, data: bytes) -> list[bytes | None]:
        """Lines that these bytes complete, without their ends; None for one that was too long."""
        lines: list[bytes | None] = []
        if self._is_after_cr:
            data = data.removeprefix(b"\n")
        self._is_after_cr = data.endswith(b"\r")
        *ends, rest = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        for end in ends:
            self._add(end)
            lines.append(None if self._dropped else bytes(self._line))
            self._line.clear()
            self._dropped = 0
        self._add(rest)
        return lines

    def _add(self, part: bytes) -> None:
        if self._dropped or len(self._line) + len(part) > LONGEST_LINE:
            self._dropped += len(self._line) + len(part)
            self._line.clear()
        else:
            self._line += part
