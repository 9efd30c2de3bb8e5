"""What stops the table, read from the rig file before anything else of it: [shaker] and [trigger] alone.

Nothing else that is wrong with the file may keep a moving table moving: a wrong key, a survey that is missing, a syntax
error three sections later. So the two sections are cut out of the text, what of them can be read is used, and drivers
are built for stopping only (``for_stopping``), without the keys that they do not need for it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal

from labdaemon.capture.device_executor import ThreadExecutor
from labdaemon.capture.rig import DeviceHandle, Rig
from labdaemon.errors import ConfigError
from labdaemon.tomlfile import MAX_BYTES, nearest, parse_toml

Kind = Literal["shaker", "trigger"]

HEADER = re.compile(r"""^\s*\[\[?\s*([A-Za-z0-9_-]+|"[^"]*"|'[^']*')\s*(\.[^\[\]]*)?\]\]?\s*(#.*)?$""")
LONGEST_STATEMENT = 400
"""Lines that one value may take."""


@dataclass(frozen=True, slots=True)
class StopActuators:
    """What of a rig can stop its table.

    Attributes
    ----------
    rig
        Shaker and trigger, and nothing else; None for what is not there or cannot be read.
    port
        The shaker's port, None where it is not known.
    is_without_shaker
        The file could be read, and names no shaker.
    troubles
        What could not be read.
    """

    rig: Rig
    port: str | None
    is_without_shaker: bool
    troubles: tuple[str, ...] = ()


def read_stop_actuators(path: Path, *, exclusive: bool = True) -> StopActuators:
    """Read what stops the table from a rig file, even where the rest of it is wrong.

    Parameters
    ----------
    path
        The rig file.
    exclusive
        Lock device files; False opens a port although a daemon that hangs holds it.

    Raises
    ------
    ConfigError
        The file cannot be read at all.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES).decode("utf-8-sig", errors="replace")
    except OSError as exc:
        raise ConfigError(f"cannot be read ({exc.strerror or exc})", source=path) from None
    sections, is_whole, troubles = cut_sections(text)
    built: dict[Kind, DeviceHandle[Any] | None] = {"shaker": None, "trigger": None}
    kinds: tuple[Kind, Kind] = ("shaker", "trigger")
    for kind in kinds:
        section = sections.get(kind)
        if section is None:
            continue
        try:
            built[kind] = _build(kind, section, exclusive)
        except ConfigError as exc:
            troubles.append(str(exc))
    port = sections.get("shaker", {}).get("port")
    is_without = is_whole and "shaker" not in sections
    rig = Rig(built["shaker"], built["trigger"], {})
    return StopActuators(rig, port if isinstance(port, str) else None, is_without, tuple(troubles))


def cut_sections(text: str) -> tuple[dict[str, dict[str, Any]], bool, list[str]]:
    """[shaker] and [trigger] of a rig file's text, with their subtables.

    Returns
    -------
    tuple
        The sections that could be read, at least in part; whether the whole text is TOML; and what could not be read.
    """
    try:
        whole = parse_toml(text)
    except ConfigError:  # the sections are read one by one below: a typing mistake must not keep the table moving
        pass
    else:
        return {kind: whole[kind] for kind in ("shaker", "trigger") if isinstance(whole.get(kind), dict)}, True, []
    lines = list(_own_lines(text.splitlines()))
    troubles: list[str] = []
    try:
        found = parse_toml("\n".join(lines))
    except ConfigError:
        found, troubles = _salvage(lines)
    return {kind: found[kind] for kind in ("shaker", "trigger") if isinstance(found.get(kind), dict)}, False, troubles


def _own_lines(lines: list[str]) -> Iterator[str]:
    """Lines of the two sections, and dotted keys of theirs before the first section."""
    inside, before_first = False, True
    for line in lines:
        header = HEADER.match(line)
        if header is not None:
            before_first = False
            inside = header[1].strip("\"'") in ("shaker", "trigger")
        if inside or (before_first and re.match(r"\s*(shaker|trigger)\s*[.=]", line)):
            yield line


def _salvage(lines: list[str]) -> tuple[dict[str, Any], list[str]]:
    """What of the lines can be read statement by statement; a header that another follows may repeat."""
    good: list[str] = []
    troubles: list[str] = []
    place = 0
    while place < len(lines):
        for end in range(place + 1, min(place + LONGEST_STATEMENT, len(lines)) + 1):
            try:
                parse_toml("\n".join([*good, *lines[place:end]]))
            except ConfigError:
                if end < len(lines) and HEADER.match(lines[end]) is None and _is_open(lines[place:end]):
                    continue
                troubles.append(f"this line of the rig file cannot be read: {lines[place].strip()[:80]!r}")
                place += 1
            else:
                good += lines[place:end]
                place = end
            break
    return parse_toml("\n".join(good)), troubles


def _is_open(lines: list[str]) -> bool:
    """Whether a value continues in the next line: brackets or a long text that have not ended."""
    text = "\n".join(lines)
    return text.count("[") > text.count("]") or text.count('"""') % 2 == 1 or text.count("'''") % 2 == 1


def _build(kind: Kind, section: Mapping[str, Any], exclusive: bool) -> DeviceHandle[Any] | None:
    driver = section.get("driver")
    if not isinstance(driver, str):
        raise ConfigError("its driver cannot be read", key=kind)
    if kind == "trigger" and driver == "camera":
        return None
    installed = entry_points(group=f"labdaemon.{kind}s")
    # A misspelt name is refused later; for stopping, the driver that was meant is better than none.
    name = driver if driver in installed.names else nearest(driver, sorted(installed.names))
    if name is None:
        raise ConfigError(f"no {kind} driver {driver!r}", key=f"{kind}.driver")
    try:
        loaded: Any = installed[name].load()
    except (ImportError, AttributeError) as exc:
        raise ConfigError(f"driver {name} does not load: {exc}", key=f"{kind}.driver") from exc
    settings = {**section, **({} if exclusive else {"exclusive": False})}
    make: Callable[[str, Mapping[str, Any]], Any] = getattr(loaded, "for_stopping", loaded)
    return DeviceHandle(make(kind, settings), ThreadExecutor(kind))
