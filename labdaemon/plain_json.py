r"""JSON and text that any program takes: without halves of surrogate pairs.

Python keeps a file name that is no UTF-8 as text with lone surrogates. No database and no strict JSON parser takes
them, so where they leave the process they become ``\udcff`` spelled out.
"""

from __future__ import annotations

import json
from typing import Any


def dump_json(value: Any) -> str:
    """Compact JSON.

    Raises
    ------
    ValueError, TypeError
        The value is not JSON (NaN among it).
    """
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    if "\\ud" in text:  # perhaps half a pair: most texts are not looked at twice
        text = json.dumps(_plain(json.loads(text)), allow_nan=False, separators=(",", ":"))
    return text


def plain_text(text: str) -> str:
    """The text, with halves of surrogate pairs spelled out."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


def _plain(value: Any) -> Any:
    match value:
        case str():
            return plain_text(value)
        case dict():
            return {plain_text(key): _plain(part) for key, part in value.items()}
        case list():
            return [_plain(part) for part in value]
    return value
