r"""Text of a peer, bounded before anything else looks at it: size, nesting, digits, and that it is text at all.

JSON can write half of a surrogate pair (``"\ud800"``). It is no character: no file, no database and no log takes it,
so it is refused where it arrives, and nothing further in has to think of it.
"""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

INLINE_BYTES = 16 << 10
"""Requests up to this are parsed on the event loop: a millisecond at most."""
MAX_DEPTH = 32
"""Objects and lists within one another; a request has two."""
MAX_DIGITS = 400
"""Digits of a number. Python's own limit for whole numbers is 4300; no double has more than this."""


def parse_json(frame: bytes) -> Any:
    """Parse one frame of UTF-8 JSON.

    Raises
    ------
    ValueError
        It is no JSON, is nested too deeply, or has a number that JSON or a double does not know.
    """
    try:
        document = json.loads(
            frame.decode(), parse_constant=_refuse_constant, parse_float=_finite, parse_int=_whole_number
        )
    except (RecursionError, MemoryError):
        raise ValueError("nested too deeply") from None
    if _is_deeper(document, MAX_DEPTH):
        raise ValueError("nested too deeply")
    return document


def surrogate_in(value: Any) -> str | None:
    """Which part of a JSON value is no text, as ``label`` or ``notes[2]``; None if all of it is."""
    match value:
        case str():
            return None if is_text(value) else ""
        case dict():
            for key, part in value.items():
                if not is_text(key):
                    return "a name"
                if (where := surrogate_in(part)) is not None:
                    return f"{key}.{where}".rstrip(".")
        case list():
            for place, part in enumerate(value):
                if (where := surrogate_in(part)) is not None:
                    return f"[{place}].{where}".rstrip(".")
    return None


def is_text(value: str) -> bool:
    """Whether every character is one, and no half of a surrogate pair."""
    try:
        value.encode()
    except UnicodeEncodeError:  # half a surrogate pair
        return False
    return True


def bounded_text(value: Any, longest: int = 40) -> str:
    """A peer's value in a message: short, and always text."""
    try:
        text = str(value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits, a list within a list within …
        text = f"a {type(value).__name__}"
    return text[:longest].encode("ascii", "backslashreplace").decode()


def _is_deeper(value: Any, levels: int) -> bool:
    if not isinstance(value, dict | list):
        return False
    if not levels:
        return True
    return any(_is_deeper(part, levels - 1) for part in (value.values() if isinstance(value, dict) else value))


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON number")


def _finite(text: str) -> float:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"the number {text[:20]}… has more than {MAX_DIGITS} digits")
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:20]} is out of range")
    return value


def _whole_number(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"the number {text[:20]}… has more than {MAX_DIGITS} digits")
    return int(text)
