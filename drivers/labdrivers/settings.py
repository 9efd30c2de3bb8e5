"""A driver's section of the rig file, checked: unknown keys, units and ranges are named with their path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from labdaemon.errors import ConfigError


class DriverSettings(BaseModel):
    """Base of all drivers' settings: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


S = TypeVar("S", bound=DriverSettings)


def read_settings(model: type[S], section: Mapping[str, Any], *, key: str, ignore: frozenset[str] = frozenset()) -> S:
    """Check a section of the rig file against a driver's model.

    Parameters
    ----------
    model
        The driver's settings.
    section
        The section as read from TOML.
    key
        The section's path in the file, for messages.
    ignore
        Keys of the section that others read (``driver``, lens keys).

    Raises
    ------
    ConfigError
        Naming the first wrong key and what is wrong with it.
    """
    mine = {name: value for name, value in section.items() if name not in ignore}
    try:
        return model.model_validate(mine)
    except ValidationError as exc:
        first = exc.errors()[0]  # the others often follow from it
        path = ".".join([key, *(str(part) for part in first["loc"])])
        message = (
            "unknown key; check its spelling"
            if first["type"] in ("extra_forbidden", "unexpected_keyword_argument")
            else first["msg"]
        )
        raise ConfigError(message, key=path) from None


def readable_settings(model: type[S], section: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """What of a section a driver's model takes, for a driver that is only to stop its device.

    Parameters
    ----------
    model
        The driver's settings.
    section
        As read from TOML; keys that are unknown or wrong are left out.
    defaults
        For keys that the model needs and stopping does not.
    """
    kept = {name: value for name, value in section.items() if name in model.model_fields}
    for _ in range(len(kept) + 1):  # one wrong key may hide another
        try:
            model.model_validate({**defaults, **kept})
        except ValidationError as exc:
            for error in exc.errors():
                if error["loc"]:
                    kept.pop(str(error["loc"][0]), None)
        else:
            break
    return {**defaults, **kept}
