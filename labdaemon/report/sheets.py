"""Sheets of targets to print and cut out: dots for the structure, tags and rings for control, at true scale."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import UsageError
from labdaemon.imaging import code_book, dictionary
from labdaemon.report.pdf import PdfPage, pdf_bytes

FORMATS_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
MARGIN_MM = 12.0
"""Left free all round: most printers cannot reach further, and the scale bars stand in it."""
BAR_MM = 100.0  # long enough to measure a printer's scale to a per mille with a ruler
_GAP_MM = 5.0
"""Between labels, for crop marks and captions."""


@dataclass(frozen=True, slots=True)
class SheetTarget:
    """Something to print.

    Attributes
    ----------
    caption
        Printed next to it.
    draw
        Draws it with its centre at x, y on a page, mm.
    """

    caption: str
    draw: Callable[[PdfPage, float, float], None]


def dot(diameter_mm: float) -> SheetTarget:
    """A black dot."""
    return SheetTarget(f"{diameter_mm:g} mm dot", lambda page, x, y: page.disc(x, y, diameter_mm / 2.0))


def tag(family: str, number: int, size_mm: float) -> SheetTarget:
    """A square tag; `size_mm` is the side of its black square.

    Raises
    ------
    UsageError
        No such family, or no such number in it.
    """
    book = dictionary(family)
    if not 0 <= number < tag_count(family):
        raise UsageError(f"{family} has tags 0 to {tag_count(family) - 1}, not {number}")
    cells = book.markerSize + 2
    dark = cv2.aruco.generateImageMarker(book, number, cells) == 0
    cell = size_mm / cells

    def draw(page: PdfPage, x: float, y: float) -> None:
        # The black square whole and its light cells on top: between dark cells there is then no seam to shine through.
        page.rectangle(x - size_mm / 2.0, y - size_mm / 2.0, size_mm, size_mm)
        for row in range(cells):
            for first, last in _runs(~dark[row]):
                left, top = x - size_mm / 2.0 + first * cell, y + size_mm / 2.0 - row * cell
                page.rectangle(left, top - cell, (last - first) * cell, cell, 1.0)

    return SheetTarget(f"{family} {number}, {size_mm:g} mm", draw)


def tag_count(family: str) -> int:
    """How many tags a family has."""
    return len(dictionary(family).bytesList)


def ring_count(bits: int) -> int:
    """How many ring codes of `bits` segments there are."""
    return len(code_book(bits))


def ring(bits: int, number: int, diameter_mm: float) -> SheetTarget:
    """A ring code; `diameter_mm` is that of its dot, a third of the whole.

    Raises
    ------
    UsageError
        No such code book, or no such number in it.
    """
    book = code_book(bits)
    if not 1 <= number <= len(book):
        raise UsageError(f"ring codes of {bits} bits have the numbers 1 to {len(book)}, not {number}")
    code, r = book[number - 1], diameter_mm / 2.0
    ones = np.array([bool(code >> (bits - 1 - k) & 1) for k in range(bits)])

    def draw(page: PdfPage, x: float, y: float) -> None:
        page.disc(x, y, r)
        # Clockwise on paper from the right. Runs over neighbouring segments leave no seams.
        for first, last in _runs(ones):
            page.sector(x, y, 2 * r, 3 * r, -2 * np.pi * first / bits, -2 * np.pi * last / bits)

    return SheetTarget(f"ring {number} ({bits} bit), {diameter_mm:g} mm dot", draw)


def sheets(targets: Sequence[SheetTarget], label_mm: float, *, paper: str = "a4", landscape: bool = False) -> bytes:
    """Lay targets out on as many pages as they need.

    Parameters
    ----------
    targets
        What to print, in order.
    label_mm
        Side of the white square that is cut out around each.
    paper
        A key of `FORMATS_MM`.
    landscape
        Turn the paper.

    Returns
    -------
    A PDF: crop marks at each label's corners, captions between labels, on each page a bar of 100 mm in both directions
    to check the printer with.

    Raises
    ------
    UsageError
        The paper is unknown, or no label fits on it.
    """
    if paper not in FORMATS_MM:
        raise UsageError(f"no paper {paper!r}; there are {', '.join(FORMATS_MM)}")
    if not targets:
        raise UsageError("nothing to print: give ids, or a count above 0")
    short, long = FORMATS_MM[paper]
    width, height = (long, short) if landscape else (short, long)
    across, up = grid(label_mm, paper=paper, landscape=landscape)
    step_x, step_y = label_mm + _GAP_MM, label_mm + _GAP_MM
    left = (width - across * step_x + _GAP_MM) / 2.0
    top = height - MARGIN_MM
    pages: list[PdfPage] = []
    for first in range(0, len(targets), across * up):
        page = PdfPage(width, height)
        for place, target in enumerate(targets[first : first + across * up]):
            row, column = divmod(place, across)
            x, y = left + column * step_x, top - row * step_y - label_mm
            target.draw(page, x + label_mm / 2.0, y + label_mm / 2.0)
            _crop_marks(page, x, y, label_mm)
            page.text(x + 3.0, y - 3.4, target.caption, min(2.2, 1.8 * label_mm / max(len(target.caption), 1)))
        _bars(page)
        pages.append(page)
    return pdf_bytes(pages, "labdaemon targets")


def grid(label_mm: float, *, paper: str, landscape: bool) -> tuple[int, int]:
    """How many labels fit on a page, across and up.

    Raises
    ------
    UsageError
        None fits.
    """
    short, long = FORMATS_MM[paper]
    width, height = (long, short) if landscape else (short, long)
    across = int((width - 2 * MARGIN_MM + _GAP_MM) // (label_mm + _GAP_MM))
    up = int((height - 2 * MARGIN_MM) // (label_mm + _GAP_MM))
    if across < 1 or up < 1:
        room = min(width - 2 * MARGIN_MM, height - 2 * MARGIN_MM - _GAP_MM)
        raise UsageError(f"a label of {label_mm:g} mm does not fit on {paper}: {room:g} mm is the most")
    return across, up


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Stretches of True as (first, end) indices."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _crop_marks(page: PdfPage, x: float, y: float, side: float) -> None:
    for cx, away_x in ((x, -1.0), (x + side, 1.0)):
        for cy, away_y in ((y, -1.0), (y + side, 1.0)):
            page.line(cx + 0.3 * away_x, cy, cx + 2.2 * away_x, cy)
            page.line(cx, cy + 0.3 * away_y, cx, cy + 2.2 * away_y)


def _bars(page: PdfPage) -> None:
    """A bar below and one at the left: printers stretch the two directions differently."""
    x, y = (page.width_mm - BAR_MM) / 2.0, 6.0
    page.line(x, y, x + BAR_MM, y, 0.2)
    up, across = (page.height_mm - BAR_MM) / 2.0, 6.0
    page.line(across, up, across, up + BAR_MM, 0.2)
    for k in range(11):
        tall = 2.0 if k % 5 == 0 else 1.2
        page.line(x + 10.0 * k, y, x + 10.0 * k, y + tall, 0.1)
        page.line(across, up + 10.0 * k, across + tall, up + 10.0 * k, 0.1)
    page.text(x, y - 3.0, "100 mm. If it measures otherwise, print at 100 % (no fitting to the page).", 2.2)
    page.text(across - 1.2, up, "100 mm", 2.2, upright=True)
