"""`labdaemon keys`: the keys of clients on the network. The daemon follows the list while it runs."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import click

from labdaemon.durable import make_folder
from labdaemon.errors import UsageError
from labdaemon.service_section import keys_folder, read_service
from labdaemon.stream.access import CLIENTS, OWN_KEY, own_pair
from labdaemon.stream.key_files import make_pair, pair_text, write_secret
from labdaemon.stream.key_list import ListedClient, add_client, read_clients, remove_client
from labdaemon.stream.roles import Role


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def keys() -> None:
    """Make, list and revoke the keys of clients on the network.

    An observer hears events and reads; an operator commands, `stop` included.
    """


def config_argument(command: click.decorators.FC) -> click.decorators.FC:
    """The rig file, which says where keys lie."""
    return click.argument("config", type=click.Path(dir_okay=False, path_type=Path))(command)


def json_option(command: click.decorators.FC) -> click.decorators.FC:
    """`--json`."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON.")(command)


@keys.command()
@config_argument
@click.argument("name")
@click.option("--role", type=click.Choice([role.value for role in Role]), required=True, help="What the client may do.")
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="The client's secret file; NAME.key in the current folder if not given.",
)
@json_option
def make(config: Path, name: str, role: str, out: Path | None, as_json: bool) -> None:
    """Make a key for a client: its secret goes to a file, its public key to the daemon's list."""
    folder = _folder(config)
    daemon = _own_pair(folder)
    pair = make_pair(daemon)
    out = out or Path(f"{name}.key")
    if out.exists():
        raise UsageError(f"{out} exists; a secret is never written over, choose another --out")
    client = ListedClient(name, Role(role), pair.public)
    add_client(folder / CLIENTS, client)  # which refuses a name that is taken, before a secret is written
    try:
        write_secret(out, pair_text(pair, name=name, role=role))
    except BaseException as exc:
        remove_client(folder / CLIENTS, name)
        if isinstance(exc, FileExistsError):
            raise UsageError(f"{out} exists; choose another --out") from None
        raise
    _match_owner(folder)
    said = {"name": name, "role": role, "public": pair.public, "file": str(out), "daemon": daemon}
    click.echo(json.dumps(said) if as_json else f"{role} {name}: give {out} to that client, over a way that you trust")


@keys.command("list")
@config_argument
@json_option
def list_keys(config: Path, as_json: bool) -> None:
    """List the clients that may connect."""
    clients = read_clients(_folder(config) / CLIENTS)
    if as_json:
        rows = [{"name": one.name, "role": str(one.role), "public": one.public} for one in clients]
        click.echo(json.dumps({"clients": rows}))
        return
    for one in clients:
        click.echo(f"{one.role:<9} {one.name:<20} {one.public}")
    if not clients:
        click.echo("no client is listed")


@keys.command()
@config_argument
@click.argument("name")
@json_option
def revoke(config: Path, name: str, as_json: bool) -> None:
    """Remove a client from the list; a running daemon ends its connections within seconds."""
    folder = _folder(config)
    client = remove_client(folder / CLIENTS, name)
    _match_owner(folder)
    said = {"name": client.name, "role": str(client.role), "public": client.public}
    click.echo(json.dumps(said) if as_json else f"{client.role} {client.name} is revoked")


def _folder(config: Path) -> Path:
    """Where the keys of a rig lie; what else the rig file says is not looked at."""
    return keys_folder(config, read_service(config))


def _own_pair(folder: Path) -> str:
    """The daemon's public key; its pair is made if there is none."""
    make_folder(folder)
    pair = own_pair(folder)
    return pair.public


def _match_owner(folder: Path) -> None:
    """Files that an administrator has made as root belong to the owner of their folder, who runs the daemon."""
    if os.geteuid() != 0:
        return
    owner = folder.stat()
    for name in (OWN_KEY, CLIENTS):
        path = folder / name
        if path.exists() and stat.S_ISREG(path.lstat().st_mode):
            os.chown(path, owner.st_uid, owner.st_gid, follow_symlinks=False)
