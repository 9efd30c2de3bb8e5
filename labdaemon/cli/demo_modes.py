"""The modes that a search of the demo found, next to those of the simulated structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

SAME_WITHIN = 0.05
"""A mode found within this part of a true frequency is that mode."""


def mode_lines(end: Mapping[str, Any], truth: Sequence[Mapping[str, float]]) -> list[str]:
    """A table of the modes found, with the errors in per cent and in standard deviations.

    Parameters
    ----------
    end
        ``data`` of the `step.decided` that ended the search.
    truth
        ``frequency_hz`` and ``damping`` of the structure's modes.
    """
    lines = [
        f"Modes from {end.get('measured', 0)} envelopes ({end.get('reason', '')}), and the simulated structure's:",
        f"{'Hz':>9}{'sd Hz':>9}{'true Hz':>9}{'error %':>10}{'in sd':>7}"
        f"{'damping %':>11}{'sd %':>8}{'true %':>8}{'error %':>10}{'in sd':>7}",
    ]
    for mode in end.get("modes", ()):
        true = min(truth, key=lambda one: abs(one["frequency_hz"] / mode["frequency_hz"] - 1), default=None)
        line = f"{mode['frequency_hz']:>9.4f}{mode['sd_frequency_hz']:>9.4f}"
        damping = f"{100 * mode['damping']:>11.4f}{100 * mode['sd_damping']:>8.4f}"
        if true is None or abs(true["frequency_hz"] / mode["frequency_hz"] - 1) > SAME_WITHIN:
            lines.append(f"{line}{'none':>9}{'':>17}{damping}")
            continue
        lines.append(
            f"{line}{true['frequency_hz']:>9.4f}{_errors(mode, true, 'frequency_hz', '+.4f')}"
            f"{damping}{100 * true['damping']:>8.4f}{_errors(mode, true, 'damping', '+.2f')}"
        )
    return lines


def _errors(found: Mapping[str, float], true: Mapping[str, float], name: str, form: str) -> str:
    """The error in per cent of the true value, and in standard deviations."""
    error = found[name] - true[name]
    return f"{format(100 * error / true[name], form):>10}{error / found[f'sd_{name}']:>+7.1f}"
