"""What a camera says of itself, its cards, its files and its settings: the datasets of PTP."""

from __future__ import annotations

import re
from dataclasses import dataclass

from labdrivers.ptp.codes import FORMAT_FOLDER
from labdrivers.ptp.container import DatasetReader

RANGE, ENUMERATION = 1, 2
LONGEST_RANGE = 4096  # a body that states a range of millions lists no settings


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Answer to GetDeviceInfo."""

    manufacturer: str
    model: str
    version: str
    serial: str
    operations: frozenset[int]
    properties: frozenset[int]

    @classmethod
    def parse(cls, data: bytes) -> DeviceInfo:
        """From the dataset's bytes."""
        reader = DatasetReader(data)
        reader.u16(), reader.u32(), reader.u16()
        reader.string()
        reader.u16()
        operations, _events, properties = (frozenset(reader.array("<H")) for _ in range(3))
        reader.array("<H"), reader.array("<H")
        manufacturer, model, version, serial = (reader.string().strip() for _ in range(4))
        return cls(manufacturer, model, version, serial, operations, properties)


@dataclass(frozen=True, slots=True)
class StorageInfo:
    """Answer to GetStorageInfo."""

    capacity_bytes: int
    free_bytes: int

    @classmethod
    def parse(cls, data: bytes) -> StorageInfo:
        """From the dataset's bytes: capacity at 6, free bytes at 14."""
        reader = DatasetReader(data, 6)
        return cls(reader.u64(), reader.u64())


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """Answer to GetObjectInfo."""

    storage: int
    format: int
    size_bytes: int
    parent: int
    name: str
    captured_at: str
    """As ISO 8601 where the camera's own form is understood, else as it came."""

    @property
    def is_folder(self) -> bool:
        """A folder, which cameras announce like a file."""
        return self.format == FORMAT_FOLDER

    @classmethod
    def parse(cls, data: bytes) -> ObjectInfo:
        """From the dataset's bytes: size at 8, parent at 38, name at 52."""
        head = DatasetReader(data)
        storage, form = head.u32(), head.u16()
        size, parent = DatasetReader(data, 8).u32(), DatasetReader(data, 38).u32()
        tail = DatasetReader(data, 52)
        return cls(storage, form, size, parent, tail.string(), iso_time(tail.string()))


def iso_time(text: str) -> str:
    """``20260504T101112.3`` as ``2026-05-04T10:11:12.3``; anything else unchanged."""
    found = re.fullmatch(r"(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d)(\.\d+)?(Z|[+-]\d{4})?", text)
    if not found:
        return text
    year, month, day, hour, minute, second, part, zone = found.groups(default="")
    return f"{year}-{month}-{day}T{hour}:{minute}:{second}{part}{zone}"


@dataclass(frozen=True, slots=True)
class PropertyDescription:
    """Answer to GetDevicePropDesc: what a setting is now and what it can become."""

    code: int
    type_code: int
    writable: bool
    current: int | str
    values: tuple[int | str, ...]
    """Allowed values; empty when the body lists none."""

    @classmethod
    def parse(cls, data: bytes) -> PropertyDescription:
        """From the dataset's bytes."""
        reader = DatasetReader(data)
        code, type_code, writable = reader.u16(), reader.u16(), reader.u8() == 1
        reader.value(type_code)  # factory default
        current = reader.value(type_code)
        form = reader.u8()
        values: tuple[int | str, ...] = ()
        if form == ENUMERATION:
            values = tuple(reader.value(type_code) for _ in range(reader.u16()))
        elif form == RANGE:
            low, high, step = (int(reader.value(type_code)) for _ in range(3))
            if step > 0 and (high - low) // step < LONGEST_RANGE:
                values = tuple(range(low, high + 1, step))
        return cls(code, type_code, writable, current, values)
