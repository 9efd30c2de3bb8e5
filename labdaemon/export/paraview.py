"""VTK XML PolyData (`.vtp`) for ParaView: targets as points, each capture's vectors as point data.

In ParaView: *Warp By Vector* with ``CAPTURE a_mm``, or *Glyph*. Points are the mean positions, mm.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from labdaemon.export.cube import PER_CAPTURE, SCALARS, VECTORS, EnvelopeCube
from labdaemon.export.results import FolderResults

_ENDIAN = "LittleEndian"


def write(results: FolderResults, path: Path) -> None:
    """Write the file as ASCII."""
    cube = EnvelopeCube.of(results)
    places = _places(cube.vectors["mean_mm"])
    is_placed: NDArray[np.bool_] = np.asarray(np.isfinite(places).all(axis=1))
    count = int(is_placed.sum())
    root = ET.Element("VTKFile", type="PolyData", version="1.0", byte_order=_ENDIAN, header_type="UInt64")
    data = ET.SubElement(root, "PolyData")
    field = ET.SubElement(data, "FieldData")
    _text_array(field, "capture", cube.captures, tuples=True)
    for name in PER_CAPTURE:
        _array(field, name, cube.per_capture[name], tuples=True)
    piece = ET.SubElement(data, "Piece", NumberOfPoints=str(count), NumberOfVerts=str(count))
    points = ET.SubElement(piece, "PointData")
    _text_array(points, "target", [name for name, placed in zip(cube.targets, is_placed, strict=True) if placed])
    for index, capture in enumerate(cube.captures):
        for name in VECTORS:
            _array(points, f"{capture} {name}", cube.vectors[name][index][is_placed])
        for name in SCALARS:
            _array(points, f"{capture} {name}", cube.scalars[name][index][is_placed])
        _text_array(points, f"{capture} flags", list(cube.flags[index][is_placed]))
    _array(ET.SubElement(piece, "Points"), "Points", places[is_placed])
    vertices = ET.SubElement(piece, "Verts")
    _array(vertices, "connectivity", np.arange(count), kind="Int64")
    _array(vertices, "offsets", np.arange(1, count + 1), kind="Int64")
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _places(mean_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(targets, 3) mean position of each target over the captures that saw it; NaN where none did."""
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(mean_mm).all(axis=2))
    total = np.where(seen[..., None], mean_mm, 0.0).sum(axis=0)
    with np.errstate(invalid="ignore"):
        places: NDArray[np.float64] = total / seen.sum(axis=0)[:, None]
    return places


def _array(
    parent: ET.Element, name: str, values: NDArray[np.generic], *, kind: str = "Float64", tuples: bool = False
) -> None:
    attributes = {"type": kind, "Name": name, "format": "ascii"}
    if values.ndim == 2:
        attributes["NumberOfComponents"] = str(values.shape[1])
    if tuples:
        attributes["NumberOfTuples"] = str(len(values))
    # VTK's ASCII parser reads "nan"; repr keeps every digit.
    ET.SubElement(parent, "DataArray", attributes).text = " ".join(repr(value.item()) for value in values.ravel())


def _text_array(parent: ET.Element, name: str, texts: tuple[str, ...] | list[str], *, tuples: bool = False) -> None:
    """Text as VTK writes it: the codes of all characters, each text ended by 0."""
    attributes = {"type": "String", "Name": name, "format": "ascii"}
    if tuples:
        attributes["NumberOfTuples"] = str(len(texts))
    codes = [str(byte) for text in texts for byte in (*str(text).encode(), 0)]
    ET.SubElement(parent, "Array", attributes).text = " ".join(codes)
