"""Errors for programs: with `--json` each error is one JSON object on stdout, and the sentence on stderr as always."""

from __future__ import annotations

import json
import sys
from typing import Any

import click


def is_asked_for(arguments: list[str]) -> bool:
    """Whether a command line has `--json`, before what is no option any more."""
    return "--json" in arguments[: arguments.index("--") if "--" in arguments else None]


def error_document(error: Exception, exit_status: int) -> dict[str, Any]:
    """``{"error": {"type", "message", "exit_status"}}``; of a daemon's refusal also ``code``, ``name`` and its data.

    ``key``, ``device`` and ``file`` say where, if that is known.
    """
    message = error.format_message() if isinstance(error, click.ClickException) else str(error)
    about: dict[str, Any] = {"type": type(error).__name__, "message": message, "exit_status": exit_status}
    for name in ("code", "name", "key", "device", "file"):
        value = getattr(error, name, None)
        if value is not None and not callable(value):
            about[name] = value if isinstance(value, int) else str(value)
    data = getattr(error, "data", None)
    return {"error": {**data, **about} if isinstance(data, dict) else about}


def print_error(error: Exception, exit_status: int) -> None:
    """Print it, where the command line asks for JSON."""
    if is_asked_for(sys.argv[1:]):
        click.echo(json.dumps(error_document(error, exit_status), default=str))
        sys.stdout.flush()
