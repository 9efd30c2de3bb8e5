"""A page of vector graphics in millimetres, and a PDF of such pages: no more than printed targets need.

PDF 1.4 (ISO 32000-1), uncompressed, without dates, so that the same sheet gives the same file.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

POINTS_PER_MM = 72.0 / 25.4


class PdfPage:
    """One page. Origin at its lower left corner, x right, y up, millimetres; greys from 0 (ink) to 1 (paper).

    Parameters
    ----------
    width_mm, height_mm
        Its size.
    """

    def __init__(self, width_mm: float, height_mm: float) -> None:
        self.width_mm: float = width_mm
        self.height_mm: float = height_mm
        k = _number(POINTS_PER_MM)
        self._content = [f"{k} 0 0 {k} 0 0 cm"]

    def polygon(self, corners_mm: FloatArray, grey: float = 0.0) -> None:
        """Fill a polygon, (n, 2)."""
        (x, y), *rest = corners_mm
        path = [f"{_number(x)} {_number(y)} m", *(f"{_number(u)} {_number(v)} l" for u, v in rest), "h f"]
        self._content += [f"{_number(grey)} g", *path]

    def rectangle(self, x_mm: float, y_mm: float, width_mm: float, height_mm: float, grey: float = 0.0) -> None:
        """Fill a rectangle from its lower left corner."""
        box = " ".join(_number(v) for v in (x_mm, y_mm, width_mm, height_mm))
        self._content.append(f"{_number(grey)} g {box} re f")

    def disc(self, x_mm: float, y_mm: float, radius_mm: float, grey: float = 0.0) -> None:
        """Fill a circle."""
        self._content.append(f"{_number(grey)} g")
        self._content += [*_arc(x_mm, y_mm, radius_mm, 0.0, 2.0 * np.pi, start="m"), "h f"]

    def sector(
        self, x_mm: float, y_mm: float, inner_mm: float, outer_mm: float, from_rad: float, to_rad: float
    ) -> None:
        """Fill part of a ring in black; angles from +x towards +y (anticlockwise on paper)."""
        self._content.append("0 g")
        self._content += _arc(x_mm, y_mm, outer_mm, from_rad, to_rad, start="m")
        self._content += [*_arc(x_mm, y_mm, inner_mm, to_rad, from_rad, start="l"), "h f"]

    def line(self, x0_mm: float, y0_mm: float, x1_mm: float, y1_mm: float, width_mm: float = 0.1) -> None:
        """Draw a black line."""
        ends = f"{_number(x0_mm)} {_number(y0_mm)} m {_number(x1_mm)} {_number(y1_mm)} l S"
        self._content.append(f"0 G {_number(width_mm)} w {ends}")

    def text(self, x_mm: float, y_mm: float, words: str, size_mm: float = 2.5, *, upright: bool = False) -> None:
        """Write a line of ASCII in Helvetica from its lower left corner; `upright` runs it upwards."""
        escaped = words.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        turn = "0 1 -1 0" if upright else "1 0 0 1"
        place = f"{turn} {_number(x_mm)} {_number(y_mm)} Tm"
        self._content.append(f"0 g BT /F1 {_number(size_mm)} Tf {place} ({escaped}) Tj ET")

    def stream(self) -> bytes:
        """The page's content stream."""
        return "\n".join(self._content).encode("ascii", "replace")


def pdf_bytes(pages: Sequence[PdfPage], title: str) -> bytes:
    """A PDF of the pages. Viewers are asked not to scale it when printing."""
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>".encode(),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    for k, page in enumerate(pages):
        box = f"0 0 {_number(page.width_mm * POINTS_PER_MM)} {_number(page.height_mm * POINTS_PER_MM)}"
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [{box}] /Contents {5 + 2 * k} 0 R "
            "/Resources << /Font << /F1 3 0 R >> >> >>".encode()
        )
        content = page.stream()
        objects.append(b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content))
    plain = title.encode("ascii", "replace").decode().replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    objects.append(f"<< /Title ({plain}) >>".encode())
    out = bytearray(b"%PDF-1.4\n")
    offsets = []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (len(objects) + 1, len(objects))
    out += b"startxref\n%d\n%%%%EOF\n" % table
    return bytes(out)


def _number(value: float) -> str:
    text = f"{float(value):.5f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def _arc(x: float, y: float, r: float, first: float, last: float, *, start: str) -> list[str]:
    """A circular arc in cubic pieces of at most 30°, each within a millionth of the radius of the true one."""
    pieces = max(1, int(np.ceil(abs(last - first) / (np.pi / 6.0))))
    angles = np.linspace(first, last, pieces + 1)
    k = 4.0 / 3.0 * np.tan((last - first) / pieces / 4.0)
    points = np.stack([x + r * np.cos(angles), y + r * np.sin(angles)], axis=1)
    slopes = r * k * np.stack([-np.sin(angles), np.cos(angles)], axis=1)
    path = [f"{_number(points[0, 0])} {_number(points[0, 1])} {start}"]
    for a, b, da, db in zip(points[:-1], points[1:], slopes[:-1], slopes[1:], strict=True):
        six = (*(a + da), *(b - db), *b)
        path.append(" ".join(_number(v) for v in six) + " c")
    return path
