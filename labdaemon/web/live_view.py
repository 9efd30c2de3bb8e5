"""What the live page shows of an event, computed here: page and report then have one rule for each number."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from labdaemon.orbit_size import size_mm
from labdaemon.processing import shows_phase
from labdaemon.report.accuracy import semi_amplitude_sd_mm
from labdaemon.report.page_tables import number_text
from labdaemon.report.space_view import SpaceCapture, space_object

MOST_SIGNED = 24
"""Captures whose phase is known that are remembered: an envelope comes soon after its captures."""


class LiveView:
    """Turns events, in their order, into what the page shows."""

    def __init__(self) -> None:
        self._signed: deque[str] = deque(maxlen=MOST_SIGNED)

    def view(self, event: Mapping[str, Any]) -> dict[str, Any]:
        """What the page shows of an event.

        Returns
        -------
        dict
            ``seq``, ``at``, ``kind``, ``about`` (a line), and, by kind: ``space`` (an object of `space_view`, or None)
            and ``rows`` (of the table of targets); ``gauges`` (rows) and ``cameras`` (names).
        """
        kind, data = str(event["kind"]), event.get("data") or {}
        shown = {"seq": event["seq"], "at": event.get("at"), "kind": kind, "about": _about(data)}
        if kind == "envelope":
            rows = list(data.get("targets") or ())
            name = str(data.get("capture"))
            space = space_object(SpaceCapture(name, rows, name in self._signed, data.get("frequency_hz")))
            return shown | {"space": space, "rows": [_target(row) for row in rows]}
        if kind == "capture.completed":
            self._remember(data)
            cameras = sorted(str(frame["camera"]) for frame in data.get("frames") or ())
            return shown | {"gauges": [_gauge(one) for one in data.get("gauges") or ()], "cameras": cameras}
        return shown

    def _remember(self, data: Mapping[str, Any]) -> None:
        stated = {key: value for key, value in data.items() if value is not None}
        # One capture of a group stands for the others, which open at other phases.
        if shows_phase([stated, stated] if data.get("group") else [stated]):
            self._signed.append(str(data.get("group") or data.get("capture")))


def _about(data: Mapping[str, Any]) -> str:
    named = data.get("capture") or data.get("label") or data.get("name")
    parts = (named, data.get("device"), data.get("message") or data.get("reason"))
    return " · ".join(str(part) for part in parts if part)


def _target(row: Mapping[str, Any]) -> Sequence[str]:
    sizes = (number_text(size_mm(row), ".4f"), number_text(semi_amplitude_sd_mm(row), ".4f"))
    return (str(row.get("target")), *sizes, ", ".join(row.get("flags") or ()))


def _gauge(one: Mapping[str, Any]) -> Sequence[str]:
    numbers = (("amplitude_mm", ".4f"), ("sd_amplitude_mm", ".4f"), ("phase_rad", ".3f"))
    values = (number_text(one.get(name), form) for name, form in numbers)
    return (str(one.get("gauge")), str(one.get("role") or "–"), *values, str(one.get("reason") or ""))
