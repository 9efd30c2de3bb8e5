"""Who gets in at the daemon's sockets, as the rig file says it."""

from __future__ import annotations

from dataclasses import dataclass

from labdaemon.errors import ConfigError
from labdaemon.service.config import RigConfig
from labdaemon.service_section import keys_folder
from labdaemon.stream.access import CLIENTS, KeyAccess
from labdaemon.stream.key_list import read_clients
from labdaemon.stream.listener import IPC, SocketFile
from labdaemon.stream.sockets import DoorPolicy

FOR_ALL, FOR_OWNER, FOR_GROUP = 0o666, 0o600, 0o660


@dataclass(frozen=True, slots=True)
class Doors:
    """Of both sockets.

    Attributes
    ----------
    access
        The listed clients; None where no address asks for keys.
    """

    commands: DoorPolicy
    events: DoorPolicy
    access: KeyAccess | None


def open_doors(config: RigConfig) -> Doors:
    """Read keys and policy; before anything is bound.

    Raises
    ------
    ConfigError
        An address asks for keys, and no client is listed, or a key file is damaged or open to others.
    """
    service = config.service
    is_keyed = {address: service.needs_keys(address) for address in (service.commands, service.events)}
    access = _open_access(config) if any(is_keyed.values()) else None

    def policy(address: str) -> DoorPolicy:
        place = _socket_file(service.local_operators) if address.startswith(IPC) else None
        return DoorPolicy(access if is_keyed[address] else None, place)

    return Doors(policy(service.commands), policy(service.events), access)


def _open_access(config: RigConfig) -> KeyAccess:
    """The keys; a daemon that no client could reach does not start."""
    service, folder = config.service, keys_folder(config.source, config.service)
    if read_clients(folder / CLIENTS):
        return KeyAccess(folder)
    key = "commands" if service.needs_keys(service.commands) else "events"
    address = getattr(service, key)
    asks = (
        "asks for keys" if service.local_operators == "keys" else "is off loopback, where anyone could move the table,"
    )
    raise ConfigError(
        f"{address} {asks} and no client's key is listed in {folder / CLIENTS}; make one with `labdaemon keys make "
        f"{config.source} NAME --role operator`, or listen on tcp://127.0.0.1:PORT",
        source=config.source,
        key=f"service.{key}",
    )


def _socket_file(operators: str | None) -> SocketFile:
    """Permissions of a Unix socket's file."""
    if operators in {"all", "keys"}:
        return SocketFile(FOR_ALL)
    if operators is not None and operators.startswith("group:"):
        return SocketFile(FOR_GROUP, operators.removeprefix("group:"))
    return SocketFile(FOR_OWNER)
