"""Lines of SCPI: program message units, headers in short and long form, and parameters (IEEE 488.2, chapter 7)."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from labdaemon.gateway.scpi_errors import ScpiError

LONGEST_MNEMONIC = 12
MOST_UNITS = 64
MOST_PARAMETERS = 16
NOT_A_NUMBER = "9.91E+37"
"""How SCPI writes a number that is not known."""

_HEADER = re.compile(r"(?P<path>\*?[A-Za-z][\w]*|:?[A-Za-z]\w*(?::[A-Za-z]\w*)*)(?P<query>\?)?(?=[\s]|$)", re.ASCII)
_NUMBER = re.compile(r"(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:\s*[eE]\s*[+-]?\d+)?)\s*(?P<suffix>[A-Za-z]*)", re.ASCII)
_WORD = re.compile(r"[A-Za-z]\w*", re.ASCII)

CommandT = TypeVar("CommandT")


@dataclass(frozen=True, slots=True)
class ProgramUnit:
    """One command or query of a line.

    Attributes
    ----------
    header
        As it was written, without the question mark.
    is_query
        It ended with one.
    parameters
        As they were written; strings with their quotes.
    """

    header: str
    is_query: bool
    parameters: tuple[str, ...] = ()


def split_line(line: str) -> list[str]:
    """The units of a line, split at semicolons outside strings; empty ones left out.

    Raises
    ------
    ScpiError
        A string does not end, or there are too many units.
    """
    units = [unit for unit in (part.strip() for part in _split(line, ";")) if unit]
    if len(units) > MOST_UNITS:
        raise ScpiError(-223, f"more than {MOST_UNITS} commands in a line")
    return units


def parse_unit(text: str) -> ProgramUnit:
    """One unit's header and parameters.

    Raises
    ------
    ScpiError
        It is no command.
    """
    if not text.isprintable():
        raise ScpiError(-101, "a character that cannot be printed")
    found = _HEADER.match(text)
    if found is None:
        first = re.match(r"[\w:*]*", text, re.ASCII)
        rest = text[first.end() : first.end() + 1] if first is not None else text[:1]
        raise ScpiError(-103 if rest == "," else -102 if rest in {"?", ":", "*", ""} else -101, text[:40])
    for mnemonic in found["path"].strip("*:").split(":"):
        if len(mnemonic) > LONGEST_MNEMONIC:
            raise ScpiError(-112, mnemonic[:40])
    rest = text[found.end() :].strip()
    parameters = tuple(part.strip() for part in _split(rest, ",")) if rest else ()
    if any(not part for part in parameters):
        raise ScpiError(-109 if len(parameters) == 1 else -103, text[:40])
    if len(parameters) > MOST_PARAMETERS:
        raise ScpiError(-108, text[:40])
    return ProgramUnit(found["path"], found["query"] is not None, parameters)


def _split(text: str, separator: str) -> Iterator[str]:
    """Parts between separators that are outside strings; a doubled quote within a string is one of its characters."""
    start, quote = 0, ""
    for place, letter in enumerate(text):
        if quote:
            if letter == quote:
                quote = ""
        elif letter in "\"'":
            quote = letter
        elif letter == separator:
            yield text[start:place]
            start = place + 1
    if quote:
        raise ScpiError(-151, "a string without its end")
    yield text[start:]


class HeaderTree(Generic[CommandT]):
    """Finds commands by their headers in short or long form, in any case.

    Parameters
    ----------
    commands
        By pattern, as ``SYSTem:ERRor[:NEXT]``: the short form is written in capitals, brackets hold what may be left
        out.
    """

    def __init__(self, commands: Iterable[tuple[str, CommandT]]) -> None:
        self._commands: dict[str, CommandT] = {}
        for pattern, command in commands:
            for spelling in _spellings(pattern):
                self._commands[spelling] = command

    def find(self, header: str, path: str = "") -> tuple[CommandT, str]:
        """The command, and the path that the next unit of the line starts from.

        Parameters
        ----------
        header
            With or without a leading colon.
        path
            Of the unit before, as ``CAPTURE:``; a header that is not found there is looked for at the root as well.

        Raises
        ------
        ScpiError
            There is none (-113).
        """
        asked = header.upper()
        if asked.startswith("*"):
            if asked in self._commands:
                return self._commands[asked], path
            raise ScpiError(-113, header[:60])
        relative = [asked.removeprefix(":")] if asked.startswith(":") or not path else [path + asked, asked]
        for spelling in relative:
            if spelling in self._commands:
                head, _, _ = spelling.rpartition(":")
                return self._commands[spelling], f"{head}:" if head else ""
        raise ScpiError(-113, header[:60])


def _spellings(pattern: str) -> Iterator[str]:
    """Every way to write a header, in capitals."""
    if pattern.startswith("*"):
        yield pattern.upper()
        return
    nodes = re.findall(r"(\[?):?([A-Za-z]+)\]?", pattern)
    choices: list[tuple[str, ...]] = []
    for bracket, name in nodes:
        short, full = "".join(letter for letter in name if letter.isupper()), name.upper()
        choices.append(tuple({short, full}) + (("",) if bracket else ()))
    for chosen in itertools.product(*choices):
        yield ":".join(part for part in chosen if part)


def read_text(parameter: str) -> str:
    """A string parameter without its quotes; a plain word is taken as it is.

    Raises
    ------
    ScpiError
        It is neither.
    """
    quote = parameter[:1]
    if quote in {'"', "'"}:
        inner = parameter[1:-1]
        if len(parameter) < 2 or parameter[-1] != quote or inner.replace(quote * 2, "").count(quote):
            raise ScpiError(-151, parameter[:40])
        return inner.replace(quote * 2, quote)
    if re.fullmatch(r"[\w.+-]+", parameter):
        return parameter
    raise ScpiError(-104, f"{parameter[:40]} is no string; write it in quotes")


def read_number(parameter: str, units: dict[str, float]) -> float:
    """A number with an optional suffix, in the first unit of `units`.

    Parameters
    ----------
    units
        Suffix in capitals -> factor.

    Raises
    ------
    ScpiError
        It is no number, or has another suffix.
    """
    found = _NUMBER.fullmatch(parameter)
    if found is None:
        raise ScpiError(-104 if _WORD.match(parameter) or parameter[:1] in {'"', "'"} else -120, parameter[:40])
    suffix = found["suffix"].upper()
    if suffix and suffix not in units:
        raise ScpiError(-131 if units else -138, f"{suffix[:20]}; known are {', '.join(units) or 'none'}")
    value = float(re.sub(r"\s", "", found["number"])) * (units[suffix] if suffix else 1.0)
    if not math.isfinite(value):
        raise ScpiError(-222, parameter[:40])
    return value


def read_flag(parameter: str) -> bool:
    """``ON``, ``OFF`` or a number, where everything but 0 is on.

    Raises
    ------
    ScpiError
        It is neither.
    """
    match parameter.upper():
        case "ON" | "TRUE":
            return True
        case "OFF" | "FALSE":
            return False
    return round(read_number(parameter, {})) != 0


def quoted(text: str) -> str:
    """A string as it is answered: printable ASCII on one line, in double quotes."""
    plain = "".join(letter if letter.isprintable() else " " for letter in text)
    return '"' + plain.encode("ascii", "backslashreplace").decode().replace('"', '""') + '"'


def number(value: float | None) -> str:
    """A number as it is answered."""
    return NOT_A_NUMBER if value is None or not math.isfinite(value) else f"{value:.9g}"


def block(data: bytes) -> bytes:
    """Definite-length arbitrary block: ``#``, the digits of the length, the length, the bytes."""
    length = str(len(data)).encode()
    return b"#" + str(len(length)).encode() + length + data
