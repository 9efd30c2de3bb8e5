"""Grey TIFF and PNG files as other programs write them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from labdaemon.errors import DataError
from labdaemon.imaging.raw import read_frame


def image(dtype: type, shape: tuple[int, int] = (60, 80)) -> np.ndarray:
    return np.random.default_rng(2).integers(0, np.iinfo(dtype).max, shape).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    "compression", [1, 5, 8, 32773, 32946], ids=["none", "LZW", "deflate", "PackBits", "old deflate"]
)
def test_opencv_s_compressions(
    tmp_path: Path, dtype: type, compression: int, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "t.tif"
    cv2.imwrite(str(path), image(dtype), [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    capfd.readouterr()
    np.testing.assert_array_equal(read_frame(path).values, image(dtype))
    assert capfd.readouterr().err == ""


def retagged(path: Path, code: int, value: int) -> None:
    """Change a short value of a little-endian TIFF in place."""
    data = bytearray(path.read_bytes())
    (first,) = struct.unpack("<I", data[4:8])
    for at in range(first + 2, len(data), 12):
        if struct.unpack("<H", data[at : at + 2])[0] == code:
            data[at + 8 : at + 10] = struct.pack("<H", value)
            break
    path.write_bytes(data)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [1, 5])
def test_white_is_zero_and_orientation(tmp_path: Path, dtype: type, compression: int) -> None:
    path = tmp_path / "t.tif"
    cv2.imwrite(str(path), image(dtype), [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    retagged(path, 262, 0)
    np.testing.assert_array_equal(read_frame(path).values, np.iinfo(dtype).max - image(dtype))
    tifffile.imwrite(path, image(dtype), metadata=None, photometric="miniswhite", extratags=[(274, "H", 1, 6, True)])
    np.testing.assert_array_equal(read_frame(path).values, np.iinfo(dtype).max - image(dtype))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True])
def test_tiles_byte_orders_and_bigtiff(tmp_path: Path, dtype: type, order: str, big: bool) -> None:
    path = tmp_path / "t.tif"
    tifffile.imwrite(path, image(dtype), byteorder=order, bigtiff=big, tile=(32, 32), metadata=None)
    np.testing.assert_array_equal(read_frame(path).values, image(dtype))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("first", [True, False])
def test_a_thumbnail_is_no_page(tmp_path: Path, first: bool, order: str, big: bool) -> None:
    path = tmp_path / "t.tif"
    with tifffile.TiffWriter(path, byteorder=order, bigtiff=big) as writer:
        if first:
            writer.write(image(np.uint16)[::4, ::4], subfiletype=1, metadata=None)
        writer.write(image(np.uint16), subifds=0 if first else 1, metadata=None)
        if not first:
            writer.write(image(np.uint16)[::4, ::4], subfiletype=1, metadata=None)
    np.testing.assert_array_equal(read_frame(path).values, image(np.uint16))


def refused(kind: str, path: Path) -> None:
    values = image(np.uint16)
    match kind:
        case "pages":
            tifffile.imwrite(path, np.stack([values, values, values]), photometric="minisblack", metadata=None)
        case "ImageJ stack":
            tifffile.imwrite(path, np.stack([values, values]), imagej=True)
        case "colour":
            tifffile.imwrite(path, np.dstack([values] * 3), photometric="rgb", metadata=None)
        case "palette":
            tifffile.imwrite(path, image(np.uint8), photometric="palette", colormap=np.zeros((3, 256), np.uint16))
        case "alpha":
            tifffile.imwrite(
                path, np.dstack([values] * 2), photometric="minisblack", planarconfig="contig", metadata=None
            )
        case "float":
            tifffile.imwrite(path, values.astype(np.float32), metadata=None)
        case "signed":
            tifffile.imwrite(path, values.astype(np.int16), metadata=None)
        case "32 bits":
            tifffile.imwrite(path, values.astype(np.uint32), metadata=None)
        case "bilevel":
            tifffile.imwrite(path, values > 30000, metadata=None)
        case "unknown compression":
            tifffile.imwrite(path, values, metadata=None)
            retagged(path, 259, 50013)
        case "spoilt LZW":
            cv2.imwrite(str(path), values, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
            data = bytearray(path.read_bytes())
            data[40:4000] = bytes(range(251)) * 15 + bytes(3960 - 251 * 15)
            path.write_bytes(data)
        case "spoilt deflate":  # decodes to an image that is shifted from there on; only the checksum tells
            tifffile.imwrite(path, (values >> 12).astype(np.uint16), compression="zlib", metadata=None)
            data = bytearray(path.read_bytes())
            data[-900:-860] = bytes(40)
            path.write_bytes(data)
        case "huge header" | "no width":
            cv2.imwrite(str(path), values, [cv2.IMWRITE_TIFF_COMPRESSION, 8])
            retagged(path, 256, 60_000 if kind == "huge header" else 0)
            retagged(path, 257, 60_000)
        case "alpha PNG":
            wide = np.frombuffer(b"".join(b"\0" + bytes(160) for _ in range(60)), np.uint8)
            path.write_bytes(png(struct.pack(">IIBBBBB", 80, 60, 8, 4, 0, 0, 0), zlib.compress(wide.tobytes())))
        case "four-bit PNG":
            rows = b"".join(b"\0" + bytes(40) for _ in range(60))
            path.write_bytes(png(struct.pack(">IIBBBBB", 80, 60, 4, 0, 0, 0, 0), zlib.compress(rows)))
        case "spoilt PNG":
            data = bytearray(cv2.imencode(".png", values)[1].tobytes())
            data[len(data) // 2] ^= 255
            path.write_bytes(data)
        case "short stream in a PNG":
            header = struct.pack(">IIBBBBB", 80, 60, 16, 0, 0, 0, 0)
            path.write_bytes(png(header, zlib.compress(b"\0" + bytes(160))))
        case _:
            raise AssertionError(kind)


def png(header: bytes, stream: bytes) -> bytes:
    chunks = ((b"IHDR", header), (b"IDAT", stream), (b"IEND", b""))
    body = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("pages", r"holds 3 images \(pages\)"),
        ("ImageJ stack", "holds 2 images"),
        ("colour", "colour image"),
        ("palette", "palette"),
        ("alpha", "alpha"),
        ("float", "floating-point values of 32 bits"),
        ("signed", "signed values of 16 bits"),
        ("32 bits", "unsigned values of 32 bits"),
        ("bilevel", "of 1 bits"),
        ("unknown compression", "cannot be decoded"),
        ("spoilt LZW", "cannot be decoded"),
        ("spoilt deflate", "cannot be decoded"),
        ("huge header", "bytes of pixels for 60000x60000"),
        ("no width", "has no pixels: 0x60000"),
        ("alpha PNG", "alpha"),
        ("four-bit PNG", "of 4 bits"),
        ("spoilt PNG", "checksum"),
        ("short stream in a PNG", "cannot be decoded"),
    ],
)
def test_what_cannot_be_used_is_named_for_what_it_is(
    tmp_path: Path, kind: str, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / ("f.png" if "PNG" in kind else "f.tif")
    refused(kind, path)
    capfd.readouterr()
    with pytest.raises(DataError, match=says) as caught:
        read_frame(path)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("tail", [b"\0", bytes(64), b"appended by a camera" * 100])
def test_what_follows_a_png_is_left_alone(tmp_path: Path, tail: bytes) -> None:
    path = tmp_path / "p.png"
    path.write_bytes(cv2.imencode(".png", image(np.uint16))[1].tobytes() + tail)
    np.testing.assert_array_equal(read_frame(path).values, image(np.uint16))
    path.write_bytes(cv2.imencode(".png", image(np.uint16))[1].tobytes()[:-13])
    with pytest.raises(DataError, match="truncated"):
        read_frame(path)
