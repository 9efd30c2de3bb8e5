"""Who may do what: the roles of clients, and the commands of each."""

from __future__ import annotations

from enum import StrEnum

from labdaemon.stream.messages import ForbiddenError
from labdaemon.stream.text_limits import bounded_text


class Role(StrEnum):
    """What a client may do. Whoever comes over loopback is an operator unless the rig file says otherwise."""

    OBSERVER = "observer"
    """Reads: events, and the commands of `OBSERVER_COMMANDS`."""
    OPERATOR = "operator"
    """Everything, ``stop`` included."""


OBSERVER_COMMANDS = frozenset(
    {"status", "rig", "campaign.list", "campaign.show", "events.replay", "events.latest", "rpc.discover"}
)
"""Commands that change nothing. A command that is not here is for operators, so a new one is never open by mistake."""


def check_role(method: str, role: Role | None) -> None:
    """Refuse a command that this client may not give.

    Parameters
    ----------
    role
        The client's; None for one whose key is not listed (any more).

    Raises
    ------
    ForbiddenError
        Names the command and the role that it needs.
    """
    if role is Role.OPERATOR or (role is Role.OBSERVER and method in OBSERVER_COMMANDS):
        return
    if role is None:
        raise ForbiddenError("this client's key is not listed")
    raise ForbiddenError(f"{bounded_text(method, 80)} is for operators, and this client is an {role}")
