"""An envelope event as the file ``envelope.csv`` has it."""

from __future__ import annotations

from typing import Any

from labdaemon.processing import ENVELOPE_COLUMNS, csv_text


def envelope_csv(event: dict[str, Any] | None) -> str:
    """Header and one line a target; the header alone where there is no envelope yet."""
    if event is None:
        return csv_text(ENVELOPE_COLUMNS, [])
    capture = event["data"]["capture"]
    empty = dict.fromkeys(ENVELOPE_COLUMNS)
    rows = [empty | {"capture": capture} | row for row in event["data"]["targets"]]
    return csv_text(ENVELOPE_COLUMNS, [{name: row[name] for name in ENVELOPE_COLUMNS} for row in rows])
