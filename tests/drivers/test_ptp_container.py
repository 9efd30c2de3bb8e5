from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdrivers.ptp.container import (
    BadContainer,
    DatasetReader,
    pack,
    pack_parameters,
    pack_string,
    read_header,
    unpack_parameters,
)
from labdrivers.ptp.datasets import DeviceInfo, ObjectInfo, PropertyDescription, StorageInfo, iso_time
from labdrivers.ptp.events import parse_nikon_events
from labdrivers.ptp.exposure import raw_seconds

PARSERS = [DeviceInfo.parse, ObjectInfo.parse, PropertyDescription.parse, StorageInfo.parse, read_header]


def test_containers_as_the_standard_prints_them():
    opened = pack(1, 0x1002, 1, pack_parameters(1))
    assert opened == bytes.fromhex("10000000 0100 0210 01000000 01000000")
    header = read_header(opened)
    assert (header.length, header.kind, header.code, header.transaction) == (16, 1, 0x1002, 1)
    assert unpack_parameters(opened[12:]) == (1,)


@given(st.text(st.characters(min_codepoint=1, max_codepoint=0xD7FF), max_size=100))
def test_strings(text):
    assert DatasetReader(pack_string(text)).string() == text


@given(st.sampled_from(PARSERS), st.binary(max_size=300))
def test_any_bytes_are_a_dataset_or_refused(parse, data):
    with suppress(BadContainer):
        parse(data)


@given(st.binary(max_size=60))
def test_any_bytes_as_nikon_events(data):
    assert len(parse_nikon_events(data)) <= max(0, len(data) - 2) // 6


def test_a_device_info_byte_by_byte():
    """The dataset of ISO 15740, written out by hand."""
    data = (
        bytes.fromhex("6400 0a000000 6400 00 0000")
        + bytes.fromhex("02000000 0110 c790")
        + bytes.fromhex("01000000 0240")
        + bytes.fromhex("01000000 0150")
        + bytes.fromhex("00000000 01000000 0138")
        + b"\x06N\0i\0k\0o\0n\0\0\0"
        + b"\x04D\08\x000\0\0\0"
        + b"\x00"
        + b"\x041\x002\x003\0\0\0"
    )
    info = DeviceInfo.parse(data)
    assert (info.manufacturer, info.model, info.version, info.serial) == ("Nikon", "D80", "", "123")
    assert info.operations == {0x1001, 0x90C7}
    assert info.properties == {0x5001}


def test_a_property_with_a_range_and_one_with_a_list():
    battery = PropertyDescription.parse(bytes.fromhex("0150 0200 00 64 5a 01 00 64 01"))
    assert (battery.current, battery.writable, len(battery.values)) == (90, False, 101)
    f_number = PropertyDescription.parse(bytes.fromhex("0750 0400 01 1801 800c 02 0200 1801 800c"))
    assert (f_number.current, f_number.writable, f_number.values) == (3200, True, (280, 3200))


@pytest.mark.parametrize(
    ("code", "raw", "seconds"),
    [
        (0x500D, 10000, 1.0),
        (0x500D, 0xFFFFFFFF, None),
        (0xD100, 0x000100FA, 1 / 250),
        (0xD100, 0x000D000A, 1.3),
        (0xD100, 0x001E0001, 30.0),
        (0xD100, 0xFFFFFFFF, None),
        (0xD100, 0x00010000, None),
    ],
)
def test_shutter_values(code, raw, seconds):
    assert raw_seconds(code, raw) == seconds


def test_times():
    assert iso_time("20260504T101112.3") == "2026-05-04T10:11:12.3"
    assert iso_time("yesterday") == "yesterday"
