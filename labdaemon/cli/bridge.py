"""`labdaemon bridge`: a daemon's events on other buses, until Ctrl-C."""

from __future__ import annotations

import json
import os
from contextlib import closing
from pathlib import Path
from typing import Literal

import click

from labdaemon.cli.remote import REPLAY_TIMEOUT_S, address_options, ask, key_file
from labdaemon.errors import UsageError
from labdaemon.stream.client import Client
from labdaemon.stream.client_sockets import events_at


@click.group()
def bridge() -> None:
    """Pass a daemon's events on to another bus, until Ctrl-C."""


@bridge.command()
@click.option("--broker", default="127.0.0.1:1883", show_default=True, metavar="HOST:PORT")
@click.option("--prefix", default="labdaemon", show_default=True, help="First part of all topics.")
@click.option("--username", help="The password comes from the environment variable LABDAEMON_MQTT_PASSWORD.")
@click.option("--tls", is_flag=True, help="Encrypted, with the system's certificates.")
@click.option("--after", type=click.IntRange(min=0), help="Begin after this event where the broker knows no place.")
@address_options
def mqtt(
    broker: str, prefix: str, username: str | None, tls: bool, after: int | None, address: str, as_json: bool
) -> None:
    """To an MQTT broker. The last event of each kind is retained; a bridge that is started anew continues."""
    _need("paho", "mqtt")
    from labdaemon.bridge.follow import Place, follow_events
    from labdaemon.bridge.mqtt_bridge import BrokerSettings, MqttBridge

    host, _, port = broker.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 1 << 16:
        raise UsageError(f"--broker {broker}: write HOST:PORT")
    password = os.environ.get("LABDAEMON_MQTT_PASSWORD")
    settings = BrokerSettings(host.strip("[]"), int(port), prefix, username, password, tls)
    with _client(address) as client, closing(MqttBridge(settings)) as to_broker:
        place = to_broker.connect() or (Place(after) if after is not None else None)
        sentence = f"events to {broker} under {prefix}/; Ctrl-C ends it"
        click.echo(json.dumps({"broker": broker, "prefix": prefix}) if as_json else sentence)
        with closing(follow_events(client, place)) as events:  # Ctrl-C is how it ends
            to_broker.run(events)


@bridge.command()
@click.option("--bind", default="tcp://127.0.0.1:5578", show_default=True, help="Where RemoteDispatchers connect to.")
@click.option("--proxy", metavar="TCP", help="Publish to a bluesky-0MQ-proxy instead.")
@click.option(
    "--serializer",
    type=click.Choice(["pickle", "json"]),
    default="pickle",
    show_default=True,
    help="json: safer; RemoteDispatcher(..., deserializer=json.loads).",
)
@click.option("--after", type=click.IntRange(min=0), help="Begin after this event; by default with the open campaign.")
@click.option(
    "--state", type=click.Path(dir_okay=False, path_type=Path), help="File that keeps the place over restarts."
)
@click.option("--wait/--no-wait", default=True, show_default=True, help="Begin when the first dispatcher has come.")
@address_options
def bluesky(
    bind: str,
    proxy: str | None,
    serializer: Literal["pickle", "json"],
    after: int | None,
    state: Path | None,
    wait: bool,
    address: str,
    as_json: bool,
) -> None:
    """To bluesky: documents of its event model for RemoteDispatchers. A campaign is a run."""
    from labdaemon.bridge.bluesky_bridge import DocumentPublisher, publish_events, read_place
    from labdaemon.bridge.bluesky_documents import DocumentMaker
    from labdaemon.bridge.follow import Place, follow_events, open_campaign_place

    kept = read_place(state) if state is not None else None
    with _client(address) as client:
        where = DocumentPublisher(proxy or bind, is_proxy=proxy is not None, serializer=serializer)
        with where as publisher:
            sentence = f"documents on {publisher.address}; Ctrl-C ends it"
            click.echo(json.dumps({"documents": publisher.address}) if as_json else sentence)
            if wait:
                publisher.wait_for_subscriber()
            begin = kept.before_open if kept is not None else Place(after) if after is not None else None
            maker = DocumentMaker(Path(client.call("rig")["service"]["data"]))
            with closing(follow_events(client, begin or open_campaign_place(client))) as events:
                publish_events(
                    events, maker, publisher.publish, place=kept, state=state,
                    remember=publisher.remember, greet=publisher.greet,
                )  # fmt: skip


def _client(address: str) -> Client:
    """Connected to a daemon that answers now; later it may go and come."""
    events = ask(address, "rig")["service"]["events"]
    return Client(address, events_at(events, address), timeout_s=REPLAY_TIMEOUT_S, key=key_file())


def _need(module: str, extra: str) -> None:
    from importlib.util import find_spec

    if find_spec(module) is None:
        raise UsageError(f"{module} is not installed; run: pip install 'labdaemon[{extra}]'")
