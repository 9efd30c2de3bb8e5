"""Result files read back, whoever had them in hands meanwhile: a spreadsheet, a script, a disk that was full.

A file of another form is refused in one line that says where it departs and what to do. A number is never guessed:
where a spreadsheet has turned decimal points into commas it may have turned other things into dates.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path

from labdaemon.errors import DataError
from labdaemon.plain_file import check_plain_file
from labdaemon.processing.tables import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, Row, Value

REMEDY = "`labdaemon process` writes it anew"
LARGEST = 1e9
"""Millimetres or pixels beyond which a number is none of a motion."""
SHOWN = 4
"""Columns that are named in a message."""

_TEXT_COLUMNS = frozenset({"capture", "camera", "target"})
_FLAGS = re.compile(r"([a-z]\w*(;[a-z]\w*)*)?")


def read_csv(path: Path) -> list[Row]:
    """Read `envelope.csv` or `measurements.csv` back as the rows that were written (numbers to six decimals).

    Columns that this version does not know are numbers, or text where they are none. ``nan`` counts as empty.

    Raises
    ------
    DataError
        The file cannot be read, or is no such file (any more): one line with the place and what to do.
    """
    check_plain_file(path)
    try:
        # A spreadsheet puts a byte order mark at the beginning; it does no harm.
        text = path.read_text(encoding="utf-8-sig")
    except OSError as exc:
        raise DataError(f"cannot be read ({exc.strerror or exc})", file=path) from None
    except UnicodeDecodeError as exc:
        raise DataError(f"is not UTF-8 text (byte {exc.start}); {REMEDY}", file=path) from None
    if not text.strip():
        return []
    try:
        lines = csv.reader(io.StringIO(text, newline=""), strict=True)
        header = next(lines)
        known = _check_header(header, path)
        rows = [_row(header, cells, lines.line_num, path) for cells in lines if cells]
    except csv.Error as exc:
        raise DataError(f"line {lines.line_num} is no line of a table ({exc}); {REMEDY}", file=path) from None
    _check_repeated(rows, [name for name in known if name in _TEXT_COLUMNS], path)
    return rows


def _check_header(header: Sequence[str], path: Path) -> tuple[str, ...]:
    """The columns that the file must have."""
    known = MEASUREMENT_COLUMNS if "camera" in header else ENVELOPE_COLUMNS
    wanted = known[: known.index("flags") + 1]  # later versions added columns behind these
    missing = [name for name in wanted if name not in header]
    if missing and len(header) == 1 and (mark := re.search(r"capture([;\t|])", header[0])):
        separator = "tabs" if mark[1] == "\t" else repr(mark[1])
        raise DataError(
            f"has {separator} between its columns, as a spreadsheet saves them: its numbers may have changed, too; "
            f"{REMEDY}",
            file=path,
        )
    if not {"capture", "target"} & set(header):
        raise DataError(f"is no result file of labdaemon: its columns are {_listed(header)}; {REMEDY}", file=path)
    if missing:
        raise DataError(f"lacks the columns {_listed(missing)}; {REMEDY}", file=path)
    twice = [name for name in wanted if header.count(name) > 1]
    if twice:
        raise DataError(f"has the column {twice[0]} twice; {REMEDY}", file=path)
    return wanted


def _listed(names: Sequence[str]) -> str:
    short = [name if len(name) <= 30 else f"{name[:27]}..." for name in names[:SHOWN]]
    return ", ".join(short) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def _row(header: Sequence[str], cells: Sequence[str], line: int, path: Path) -> Row:
    if len(cells) != len(header):
        raise DataError(
            f"line {line} has {len(cells)} values where the header has {len(header)}: it was cut, edited, or is being "
            f"written; {REMEDY}",
            file=path,
        )
    row: Row = {}
    for column, text in zip(header, cells, strict=True):
        if column in _TEXT_COLUMNS:
            row[column] = text
        elif column == "flags":
            if not _FLAGS.fullmatch(text):
                raise DataError(f"line {line}: {text!r} is no flag; are columns shifted? {REMEDY}", file=path)
            row[column] = text.split(";") if text else []
        else:
            row[column] = _number(column, text, line, path)
    return row


def _number(column: str, text: str, line: int, path: Path) -> Value:
    """A number, None where the cell is empty; text in a column of another program."""
    try:
        value = float(text) if text.strip() else math.nan
    except ValueError:
        if column not in ENVELOPE_COLUMNS and column not in MEASUREMENT_COLUMNS:
            return text
        raise DataError(f"line {line}, {column}: {text[:30]!r} is no number; {REMEDY}", file=path) from None
    is_length = column.endswith(("_mm", "_px"))
    if math.isinf(value) or (is_length and abs(value) > LARGEST):
        raise DataError(f"line {line}, {column}: {text[:30]} is no result of a measurement; {REMEDY}", file=path)
    if column.startswith("sd_") and value < 0:
        raise DataError(
            f"line {line}, {column}: {text[:30]} is no standard deviation; are columns swapped? {REMEDY}", file=path
        )
    return None if math.isnan(value) else value


def _check_repeated(rows: Sequence[Row], keys: Sequence[str], path: Path) -> None:
    seen: set[tuple[Value, ...]] = set()
    for row in rows:
        name = tuple(row[key] for key in keys)
        if name in seen:
            what = ", ".join(f"{key} {row[key]}" for key in keys)
            raise DataError(f"has {what} twice; {REMEDY}", file=path)
        seen.add(name)
