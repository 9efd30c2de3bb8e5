"""Colours of lines, which differ for all kinds of colour vision, and dashes, which differ on a grey print.

Okabe and Ito (2008), "Color universal design"; yellow is left out, as it does not show on white.
"""

from __future__ import annotations

LINE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
DASHES = ("", "7 3", "2 3", "9 3 2 3", "12 4", "4 2")


def line_style(index: int) -> str:
    """SVG attributes of the line with this number; after six they repeat."""
    dash = DASHES[index % len(DASHES)]
    return f'stroke="{LINE_COLOURS[index % len(LINE_COLOURS)]}"' + (f' stroke-dasharray="{dash}"' if dash else "")


def line_colour(index: int) -> str:
    """Its colour alone."""
    return LINE_COLOURS[index % len(LINE_COLOURS)]
