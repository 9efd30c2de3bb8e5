"""What queries answer: the daemon's JSON as one line of SCPI, or as a block."""

from __future__ import annotations

import json
from typing import Any

from labdaemon.gateway.scpi_syntax import block, number, quoted
from labdaemon.report.envelope_csv import envelope_csv

VECTORS = ("ax_mm", "ay_mm", "az_mm", "bx_mm", "by_mm", "bz_mm")
"""Numbers of a target in the answer to ``ENVelope?``, in this order."""


def identity_text(rig: str, serial: str, version: str) -> str:
    """The four fields of ``*IDN?``; commas and semicolons would separate fields or answers."""
    fields = ("labdaemon", rig or "rig", serial or "0", version)
    return ",".join("".join("-" if letter in ',;"' else letter for letter in quoted(field)[1:-1]) for field in fields)


def capture_text(capture: str | None, opened_at: str | None) -> str:
    """Name and opening of a capture; empty strings where there is none yet."""
    return f"{quoted(capture or '')},{quoted(opened_at or '')}"


def envelope_text(event: dict[str, Any] | None) -> str:
    """All targets in one line: capture, frequency, number of targets, then name, a, b and flags of each."""
    if event is None:
        return f"{quoted('')},{number(None)},0"
    data = event["data"]
    targets = data["targets"]
    head = (quoted(str(data["capture"])), number(data.get("frequency_hz")), str(len(targets)))
    return ",".join([*head, *(f"{quoted(str(row['target']))},{target_text(row)}" for row in targets)])


def target_text(row: dict[str, Any]) -> str:
    """A and b of one target in millimetres, and its flags."""
    return ",".join([*(number(row.get(name)) for name in VECTORS), quoted(";".join(row.get("flags") or ()))])


def find_target(event: dict[str, Any] | None, name: str) -> dict[str, Any] | None:
    """One target's row; None where the envelope has no such target."""
    rows: list[dict[str, Any]] = event["data"]["targets"] if event is not None else []
    return next((row for row in rows if row["target"] == name), None)


def envelope_csv_block(event: dict[str, Any] | None) -> bytes:
    """An envelope as the file ``envelope.csv`` has it, as a block; the header alone where there is none."""
    return block(envelope_csv(event).encode("utf-8", "backslashreplace"))


def envelope_json_block(event: dict[str, Any] | None) -> bytes:
    """The whole event as a block of JSON; ``null`` where there is none."""
    return block(json.dumps(event, separators=(",", ":")).encode())


def status_text(status: dict[str, Any]) -> str:
    """State, table, campaign, captures outside steps, faults."""
    words = (str(status.get("state") or "starting").upper(), str(status.get("table") or "none").upper())
    counts = (str(status.get("captures_manual") or 0), str(status.get("faults") or 0))
    return ",".join([*words, quoted(str(status.get("campaign") or "")), *counts])


def operation_bits(status: dict[str, Any]) -> int:
    """The operation status condition register: settling (2), measuring (16), waiting for a trigger (32)."""
    return (
        2 * (status.get("doing") == "settling")
        | 16 * bool(status.get("measuring"))
        | 32 * bool(status.get("captures_expected"))
    )
