"""What TOML of a person or a peer may ask of the parser, checked before it parses.

`tomllib` takes memory and time with the square of a key's dots, recurses with nesting, and leaves numbers of endless
digits to whoever prints them. The scan here follows TOML's own rules for strings and comments, in one pass: up to the
first mistake both see the same text, and after it the parser reads no further.
"""

from __future__ import annotations

import re

from labdaemon.errors import ConfigError

MAX_DOTS = 16
"""Dots of one key; a rig file needs two or three."""
MAX_DEPTH = 16
"""Arrays and inline tables within one another."""
MAX_WORD = 256
"""Characters of a bare key, a number or a date."""
MAX_KEYS = 20_000
"""Assignments, tables and arrays; the parser takes some microseconds and up to a kilobyte for each."""

_TOKEN = re.compile(
    r'''"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\''''
    r"""|"(?:\\.|[^"\\\n])*"|'[^'\n]*\'"""
    r"""|\#[^\n]*|[A-Za-z0-9_+:-]+|[ \t]+|.""",
    re.DOTALL,
)


def check_toml(text: str, *, source: object = None) -> None:
    """Refuse TOML that costs more to parse than any rig or campaign would.

    Raises
    ------
    ConfigError
        Names the line and what there is too much of.
    """
    where = str(source) if source is not None else None
    depth = dots = keys = 0
    for token in _TOKEN.finditer(text):
        match token.group()[0]:
            case ".":
                dots += 1
            case "[" | "{":
                depth, keys, dots = depth + 1, keys + 1, 0
            case "]" | "}":
                depth, dots = max(depth - 1, 0), 0
            case "=":
                keys, dots = keys + 1, 0
            case "\n":
                dots = 0
            case "," | "#":
                dots = 0
            case '"' | "'" | " " | "\t":
                continue
            case _ if len(token.group()) > MAX_WORD:
                raise _refusal(text, token, where, f"a word or number of more than {MAX_WORD} characters")
        if dots > MAX_DOTS:
            raise _refusal(text, token, where, f"a key of more than {MAX_DOTS} dots")
        if depth > MAX_DEPTH:
            raise _refusal(text, token, where, f"more than {MAX_DEPTH} brackets within one another")
        if keys > MAX_KEYS:
            raise _refusal(text, token, where, f"more than {MAX_KEYS} keys and tables")


def _refusal(text: str, token: re.Match[str], where: str | None, what: str) -> ConfigError:
    line = text.count("\n", 0, token.start()) + 1
    return ConfigError(f"is no file of ours: {what} (at line {line})", source=where)
