from __future__ import annotations

import re

import numpy as np
import pytest

from labdaemon.report.pdf import PdfPage, pdf_bytes


def outline(page: PdfPage) -> np.ndarray:
    """Points on the paths of a page, (n, 2) mm, by evaluating its operators."""
    points: list[tuple[float, float]] = []
    for line in page.stream().decode().splitlines()[1:]:
        words = line.split()
        if words[-1] in ("m", "l"):
            points.append((float(words[0]), float(words[1])))
        elif words[-1] == "c":
            control = np.array([points[-1], *np.array(words[:6], dtype=float).reshape(3, 2)])
            for t in np.linspace(0, 1, 9)[1:]:
                weights = np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3])
                points.append(tuple(weights @ control))
    return np.array(points)


def test_discs_and_sectors_are_round_to_a_micrometre() -> None:
    page = PdfPage(210, 297)
    page.disc(50.0, 60.0, 6.0)
    assert np.hypot(*(outline(page) - [50, 60]).T) == pytest.approx(6.0, abs=2e-5)
    page = PdfPage(210, 297)
    page.sector(50.0, 60.0, 8.0, 12.0, 0.3, -0.9)
    radii = np.hypot(*(outline(page) - [50, 60]).T)
    assert np.minimum(np.abs(radii - 8.0), np.abs(radii - 12.0)) == pytest.approx(0.0, abs=2e-5)
    angles = np.arctan2(*(outline(page) - [50, 60]).T[::-1])
    assert (angles.min(), angles.max()) == pytest.approx((-0.9, 0.3), abs=1e-5)


def test_the_cross_reference_table_points_at_every_object() -> None:
    pages = [PdfPage(210, 297), PdfPage(297, 210)]
    pages[0].text(10, 10, r"a (b) \c")
    data = pdf_bytes(pages, "sheet (1)")
    assert data == pdf_bytes(pages, "sheet (1)")
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF", data)[1])  # type: ignore[index]
    assert data[start:].startswith(b"xref\n0 9\n")
    offsets = [int(m) for m in re.findall(rb"(\d{10}) 00000 n", data)]
    for number, offset in enumerate(offsets, start=1):
        assert data[offset:].startswith(b"%d 0 obj\n" % number)
    for match in re.finditer(rb"/Length (\d+) >>\nstream\n", data):
        assert data[match.end() + int(match[1]) :].startswith(b"\nendstream")
    assert b"/PrintScaling /None" in data
    assert rb"(a \(b\) \\c) Tj" in data


def test_a_page_is_as_large_as_its_paper() -> None:
    data = pdf_bytes([PdfPage(210, 297)], "x")
    width, height = (float(v) for v in re.search(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data).groups())  # type: ignore[union-attr]
    assert (width * 25.4 / 72, height * 25.4 / 72) == pytest.approx((210, 297), abs=1e-4)
