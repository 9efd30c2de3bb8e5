"""A command's parameters: known by name, of the right type and size, or refused by name."""

from __future__ import annotations

from typing import Any

from labdaemon.stream.messages import InvalidParamsError
from labdaemon.stream.text_limits import bounded_text
from labdaemon.tomlfile import nearest


class CommandParameters:
    """Reads the parameters of one command.

    CommandParameters
    ----------
    params
        As they came; all text in them is text (`labdaemon.stream.messages.parse_request`).
    known
        Names that the command takes.

    Raises
    ------
    InvalidParamsError
        One has another name.
    """

    def __init__(self, params: dict[str, Any], *known: str) -> None:
        for name in params:
            if name not in known:
                near = nearest(name[:40], list(known))
                hint = f"did you mean {near}?" if near else f"known are {', '.join(known) or 'none'}"
                raise InvalidParamsError(f"unknown parameter {bounded_text(name)}; {hint}")
        self._params = params

    def text(self, name: str, *, longest: int, default: str | None = None) -> str:
        """A text; `default` where it is missing or null, unless that is None.

        Raises
        ------
        InvalidParamsError
            It is missing, no text, or too long.
        """
        value = self._params.get(name)
        if value is None:
            value = default
        if not isinstance(value, str) or len(value) > longest:
            raise InvalidParamsError(f"{name} is a text of at most {longest} characters")
        return value

    def optional_text(self, name: str, *, longest: int) -> str | None:
        """A text, None where it is missing or null."""
        return None if self._params.get(name) is None else self.text(name, longest=longest)

    def flag(self, name: str) -> bool:
        """True or false; false where it is missing or null.

        Raises
        ------
        InvalidParamsError
            It is something else.
        """
        value = self._params.get(name)
        if value is not None and not isinstance(value, bool):
            raise InvalidParamsError(f"{name} is true or false, not {bounded_text(value)}")
        return bool(value)

    def number(self, name: str, *, least: float, most: float) -> float | None:
        """A number within these bounds; None where it is missing or null.

        Raises
        ------
        InvalidParamsError
            It is no number, or outside.
        """
        value = self._params.get(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
            raise InvalidParamsError(f"{name} is a number from {least:g} to {most:g}, not {bounded_text(value)}")
        return float(value)

    def whole(self, name: str, *, least: int, most: int, default: int) -> int:
        """A whole number within these bounds; `default` where it is missing or null.

        Raises
        ------
        InvalidParamsError
            It is no whole number, or outside.
        """
        value = self._params.get(name)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise InvalidParamsError(f"{name} is a whole number from {least} to {most}, not {bounded_text(value)}")
        return value
