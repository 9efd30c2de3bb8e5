"""PTP's containers and the values in them, little-endian: bytes to values and back, nothing else.

A container is u32 length (header included), u16 kind, u16 code, u32 transaction id, then up to five u32 parameters or
the payload of a data phase. Strings are a u8 count of characters with their NUL, then UTF-16LE.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

HEADER = struct.Struct("<IHHI")
UNKNOWN_LENGTH = 0xFFFFFFFF
"""A data phase whose length the device does not know beforehand: it ends with a short packet."""
INTEGERS = {1: "<b", 2: "<B", 3: "<h", 4: "<H", 5: "<i", 6: "<I", 7: "<q", 8: "<Q"}
TYPE_STRING = 0xFFFF
"""Type codes of the standard; 9 and 10 (128 bits) and arrays occur in no property used here."""


class BadContainer(ValueError):
    """Bytes that are not what the protocol says."""


@dataclass(frozen=True, slots=True)
class ContainerHeader:
    """First twelve bytes of a container."""

    length: int
    kind: int
    code: int
    transaction: int


def read_header(data: bytes | bytearray) -> ContainerHeader:
    """Parse the header; raises `BadContainer` for bytes that can be none."""
    if len(data) < HEADER.size:
        raise BadContainer(f"{len(data)} bytes are no container")
    length, kind, code, transaction = HEADER.unpack_from(data)
    if kind not in (1, 2, 3, 4) or length < HEADER.size:
        raise BadContainer(f"{bytes(data[:12]).hex()} is no container's header")
    return ContainerHeader(length, kind, code, transaction)


def pack(kind: int, code: int, transaction: int, payload: bytes = b"") -> bytes:
    """A whole container."""
    return HEADER.pack(HEADER.size + len(payload), kind, code, transaction) + payload


def pack_parameters(*parameters: int) -> bytes:
    """Parameters of a command, response or event."""
    return struct.pack(f"<{len(parameters)}I", *parameters)


def unpack_parameters(payload: bytes) -> tuple[int, ...]:
    """Parameters as they come, at most five."""
    count = min(len(payload) // 4, 5)
    return struct.unpack_from(f"<{count}I", payload)


def pack_string(text: str) -> bytes:
    """A string as PTP has it; the empty one is a single zero."""
    if not text:
        return b"\0"
    encoded = (text + "\0").encode("utf-16-le")
    return bytes([len(encoded) // 2]) + encoded


class DatasetReader:
    """Reads values one after the other from a dataset; raises `BadContainer` past its end."""

    def __init__(self, data: bytes, offset: int = 0) -> None:
        self._data, self._at = data, offset

    def take(self, form: str) -> int:
        """One integer of a `struct` format."""
        try:
            (value,) = struct.unpack_from(form, self._data, self._at)
        except struct.error:
            raise BadContainer(f"dataset of {len(self._data)} bytes ends too early") from None
        self._at += struct.calcsize(form)
        return int(value)

    def u8(self) -> int:
        """Unsigned byte."""
        return self.take("<B")

    def u16(self) -> int:
        """Unsigned, two bytes."""
        return self.take("<H")

    def u32(self) -> int:
        """Unsigned, four bytes."""
        return self.take("<I")

    def u64(self) -> int:
        """Unsigned, eight bytes."""
        return self.take("<Q")

    def string(self) -> str:
        """A counted string without its NUL."""
        size = 2 * self.u8()
        raw = self._data[self._at : self._at + size]
        if len(raw) < size:
            raise BadContainer("string runs past the end of its dataset")
        self._at += size
        return raw.decode("utf-16-le", "replace").split("\0")[0]

    def array(self, form: str) -> tuple[int, ...]:
        """A u32 count and so many integers."""
        count = self.u32()
        if count * struct.calcsize(form) > len(self._data) - self._at:
            raise BadContainer("array runs past the end of its dataset")
        return tuple(self.take(form) for _ in range(count))

    def value(self, type_code: int) -> int | str:
        """A value of a property's type."""
        if type_code == TYPE_STRING:
            return self.string()
        if type_code not in INTEGERS:
            raise BadContainer(f"type {type_code:#06x} is not understood")
        return self.take(INTEGERS[type_code])


def pack_value(type_code: int, value: int) -> bytes:
    """An integer of a property's type."""
    return struct.pack(INTEGERS[type_code], value)
