"""Files and messages with something wrong in them: lines moved, values replaced, bytes flipped, and known bombs."""

from __future__ import annotations

import json
import random

VALUES = (
    "-1", "0", "1e308", "-1e999", "nan", "inf", '""', '"x"', "[]", "[[1]]", "{}", "{ a = 1 }", "true", "1979-05-27",
    '"\\u0000"', '"../.."', '"/"', '"\\uD7FF"', "'\x7f'", "0x" + "f" * 300, "9" * 30, "[1, 'x']", '"é\U0001f600"',
    "1e-320", '"%s%n"', '"tcp://[::1]:1"', "[" * 20 + "]" * 20, '"' + "x" * 5000 + '"',
)  # fmt: skip
BOMBS = (
    "a" + ".a" * 30_000 + " = 1\n",
    "[a" + ".a" * 30_000 + "]\n",
    "x = " + "9" * 5000 + "\n",
    "x = 0x" + "f" * 100_000 + "\n",
    "x = " + "[" * 3000 + "\n",
    "x = " + "{a=" * 3000 + "\n",
    "[[phase]]\n" * 30_000,
    '"' + "\\" * 50_000,
)
SPECIAL_BYTES = (b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b"\x1a", b"\xc3\x28")
METHODS = (
    "status", "rig", "campaign.submit", "campaign.pause", "campaign.resume", "campaign.abort", "events.replay",
    "events.latest", "rpc.discover", "nonsense", "",
)  # fmt: skip
"""Methods of messages; `capture` and `stop` would change what the daemon does."""
JSON_VALUES = (
    "null", "true", "-1", "1e308", "1e999", "NaN", "[]", "{}", '""', '"\\ud800"', '"a\\udfffb"', "9" * 400,
    '["\\ud83d"]', "0." + "1" * 500, "[" * 40 + "]" * 40, '"' + "x" * 2000 + '"', '{"\\ud800": 1}', '"\\u0000"',
    "9" * 18,
)  # fmt: skip
NAMES = ("toml", "label", "campaign", "request_id", "after", "limit", "accept_changed_rig", "unknown", "\\ud800", "")


def mutated_text(source: random.Random, text: str) -> bytes:
    """A TOML file with one to three mistakes."""
    if source.random() < 0.05:
        return (text + source.choice(BOMBS)).encode()
    lines = text.splitlines()
    for _ in range(source.randint(1, 3)):
        place = source.randrange(len(lines))
        kind = source.randrange(6)
        if kind <= 2 and "=" in lines[place]:
            lines[place] = lines[place].partition("=")[0] + "= " + source.choice(VALUES)
        elif kind == 3:
            lines.insert(place, lines[source.randrange(len(lines))])
        elif kind == 4:
            del lines[place]
            lines = lines or [""]
        else:
            lines[place] = _mutated_word(source, lines[place])
    data = "\n".join(lines).encode("utf-8", "surrogatepass")
    return mutated_bytes(source, data) if source.random() < 0.15 else data


def mutated_bytes(source: random.Random, data: bytes, *, head: int | None = None) -> bytes:
    """A file whose bytes were damaged; `head` keeps most damage within so many bytes of its beginning."""
    changed = bytearray(data)
    kind = source.randrange(6)
    if kind == 0:
        return bytes(changed[: source.randrange(len(changed) + 1)])
    if kind == 1:
        start = source.randrange(len(changed) + 1)
        changed[start:] = bytes(len(changed) - start)
        return bytes(changed)
    reach = min(head or len(changed), len(changed)) or 1
    for _ in range(source.randint(1, 12)):
        place = source.randrange(reach)
        if kind == 2:
            changed[place : place + 1] = bytes([source.randrange(256)])
        elif kind == 3:
            changed[place : place + 4] = source.choice(
                (b"\xff" * 4, bytes(4), b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f")
            )
        elif kind == 4:
            changed[place:place] = source.choice(SPECIAL_BYTES)
        else:
            del changed[place : place + source.randint(1, 16)]
    return bytes(changed)


def message(source: random.Random) -> list[bytes]:
    """Frames of one message to the commands socket."""
    kind = source.randrange(10)
    if kind == 0:
        return [source.randbytes(source.randrange(60)) for _ in range(source.randint(1, 4))]
    if kind == 1:
        return [b"", _request(source)]
    if kind == 2:
        return [mutated_bytes(source, _request(source))]
    if kind == 3 and source.random() < 0.05:
        return [source.choice((b"[" * 200_000, b'{"a":' * 60_000, b"1" * 300_000, b"x" * 900_000))]
    return [_request(source)]


def _request(source: random.Random) -> bytes:
    members = [f'"{name}": {_value(source)}' for name in _names(source)]
    request_id = source.choice(("1", '"a"', "null", "1.5", '"\\ud800"', "true", "[]", "9" * 250))
    method = json.dumps(source.choice(METHODS))
    return f'{{"jsonrpc": "2.0", "id": {request_id}, "method": {method}, "params": {{{", ".join(members)}}}}}'.encode()


def _names(source: random.Random) -> list[str]:
    return [source.choice(NAMES) for _ in range(source.randrange(3))]


def _value(source: random.Random) -> str:
    if source.random() < 0.2:
        return json.dumps(source.choice(BOMBS)[:2000])
    return source.choice(JSON_VALUES)


def _mutated_word(source: random.Random, line: str) -> str:
    if not line:
        return source.choice(VALUES)
    place = source.randrange(len(line))
    return (
        line[:place] + source.choice(("", "#", '"', "[", "]", ".", "=", "\t", "é", line[place] * 2)) + line[place + 1 :]
    )
