"""TOML that a person writes, read into a pydantic model; what is wrong is said by key, with what was probably meant."""

from __future__ import annotations

import difflib
import errno
import os
import select
import time
import tomllib
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from labdaemon.errors import ConfigError
from labdaemon.toml_limits import check_toml

MAX_BYTES = 1 << 20
"""A rig or campaign is a page of text; what is larger is some other file."""
PIPE_S = 5.0
"""How long a file that is a pipe may take to deliver."""


class TomlSection(BaseModel):
    """A table of a TOML file: frozen, and a key it does not know is an error that names the nearest one it does.

    Raises
    ------
    pydantic.ValidationError
        Translated by `parse_model` into a `ConfigError`.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, hide_input_in_errors=True
    )

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or cls.model_config.get("extra") != "forbid":
            return data
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in data:
            if key not in known:
                raise unknown_key(str(key), known)
        return data


def unknown_key(key: str, known: list[str]) -> PydanticCustomError:
    """Error for a key that nothing reads, with the nearest that something does."""
    near = nearest(key, known)
    hint = f"did you mean {near}?" if near else f"known keys are {', '.join(sorted(known))}"
    return PydanticCustomError("unknown_key", "{message}", {"message": f"unknown key; {hint}", "key": key})


def nearest(word: str, known: list[str]) -> str | None:
    """The known word that was probably meant: nearest in spelling, or the same quantity in another unit."""
    close = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.6)
    if close:
        return close[0]
    stem = word.lower().partition("_")[0]
    return next((name for name in known if name.partition("_")[0] == stem), None)


def dotted(location: tuple[int | str, ...]) -> str:
    """A key's path as a person would write it.

    >>> dotted(("phase", 2, "amplitude_mm", 1))
    'phase[2].amplitude_mm[1]'
    """
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    return path


Model = TypeVar("Model", bound=BaseModel)


def parse_model(model: type[Model], data: dict[str, Any], *, source: Path | str | None, context: Any = None) -> Model:
    """Validate a parsed TOML document.

    Raises
    ------
    ConfigError
        Names the file, the key's path and what would be right. Of several mistakes one is reported: an unknown key
        first (others often follow from it), else the deepest in the file, since that branch of a choice was meant.
    """
    try:
        return model.model_validate(data, context=context)
    except ValidationError as exc:
        raise worst_mistake(exc.errors(include_url=False), data, source=source) from None


def worst_mistake(details: list[ErrorDetails], data: dict[str, Any], *, source: Path | str | None) -> ConfigError:
    """The mistake that is reported, of several that pydantic found in a document."""
    worst = max(details, key=lambda detail: (detail["type"] == "unknown_key", len(_location(detail, data))))
    return ConfigError(_sentence(worst), source=source, key=dotted(_location(worst, data)))


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """Text and content of a TOML file.

    Raises
    ------
    ConfigError
        Missing, unreadable, too large, not UTF-8 or not TOML (with line and column).
    """
    text = read_text(path)
    return text, parse_toml(text, source=path)


def read_text(path: Path) -> str:
    """Text of a file that a person wrote: whole, bounded, and without waiting for a pipe that says nothing.

    Raises
    ------
    ConfigError
        Missing, unreadable, too large or not UTF-8.
    """
    try:
        raw = _read_bytes(path)
    except (OSError, ValueError) as exc:  # ValueError: a NUL in the path
        raise ConfigError(f"cannot be read ({getattr(exc, 'strerror', None) or exc})", source=path) from None
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"is larger than {MAX_BYTES} bytes, so it is no configuration", source=path)
    try:
        return raw.decode("utf-8-sig")  # an editor's byte order mark does no harm
    except UnicodeDecodeError as exc:
        raise ConfigError(f"is not UTF-8 text (byte {exc.start})", source=path) from None


def parse_toml(text: str, *, source: Path | str | None = None) -> dict[str, Any]:
    """Content of TOML text.

    Raises
    ------
    ConfigError
        Not TOML, with line and column; or beyond what `labdaemon.toml_limits` lets through.
    """
    try:
        size = len(text.encode())
    except UnicodeEncodeError as exc:
        raise ConfigError(f"is no text: it has half a surrogate pair (character {exc.start})", source=source) from None
    if size > MAX_BYTES:
        raise ConfigError(f"is larger than {MAX_BYTES} bytes, so it is no configuration", source=source)
    check_toml(text, source=source)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as exc:  # ValueError: TOMLDecodeError, and numbers that Python refuses
        raise ConfigError(f"is not valid TOML: {' '.join(str(exc).split())[:200]}", source=source) from None


def _read_bytes(path: Path) -> bytes:
    """At most one byte more than is taken. A pipe (``<(command)`` of a shell) has seconds to deliver."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        raw = b""
        deadline = time.monotonic() + PIPE_S
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        while len(raw) <= MAX_BYTES:
            if not poll.poll(max(deadline - time.monotonic(), 0.0) * 1000.0):
                raise TimeoutError(errno.ETIMEDOUT, f"nothing came within {PIPE_S:g} s")
            block = os.read(descriptor, MAX_BYTES + 1 - len(raw))
            if not block:
                break
            raw += block
        return raw
    finally:
        os.close(descriptor)


def _location(detail: ErrorDetails, data: dict[str, Any]) -> tuple[int | str, ...]:
    """Where in the file, without the names of union branches that pydantic puts in between."""
    location = list(detail["loc"])
    if detail["type"] == "unknown_key":
        location.append(detail.get("ctx", {})["key"])
    kept: list[int | str] = []
    node: Any = data
    for index, part in enumerate(location):
        if isinstance(node, dict):
            is_last = index == len(location) - 1
            if part not in node and not is_last:
                continue
            if part not in node and detail["type"] not in {"missing", "unknown_key"}:
                continue
            node = node.get(part)
        elif isinstance(node, list) and isinstance(part, int):
            node = node[part] if part < len(node) else None
        else:
            continue
        kept.append(part)
    return tuple(kept)


def _sentence(detail: ErrorDetails) -> str:
    """Pydantic's message in our words."""
    context = detail.get("ctx", {})
    match detail["type"]:
        case "missing":
            return "is missing"
        case "union_tag_invalid":
            tag, tags = str(context["tag"]), [part.strip(" '") for part in str(context["expected_tags"]).split(",")]
            near = nearest(tag, tags)
            return f"unknown kind {tag!r}; " + (f"did you mean {near}?" if near else f"known are {', '.join(tags)}")
        case "union_tag_not_found":
            return "has no kind"
        case "unknown_key" | "value_error":
            return str(context.get("message") or context.get("error"))
        case _:
            message = detail["msg"].removeprefix("Input ")
            return f"{message[0].lower()}{message[1:]}, not {_shown(detail['input'])}"


def _shown(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
