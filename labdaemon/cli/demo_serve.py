"""`labdaemon demo --serve`: the simulated rig stays, campaign after campaign, for clients on fixed ports."""

from __future__ import annotations

import secrets
import shlex
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from labdaemon.cli.demo_lab import DemoFailed, DemoLab, laboratory
from labdaemon.durable import write_durably

ENDLESS = """\
# One envelope after the other, for clients that join.
name = "serve"

[[phase]]
kind = "sharp"
frames = 1

[[phase]]
kind = "steps"
frequency_hz = [12.0, 8.0, 5.0]
amplitude_mm = [0.5, 1.0, 2.0]
repeats = 100
settle = { max_change_per_cycle = 0.001, timeout_s = 60 }
"""
FAILED = frozenset({"campaign.failed", "campaign.aborted", "campaign.paused"})
TOKEN_FILE = "web.token"
PATIENCE_S = 60.0
"""The lines to join with are printed with the first envelope, so that the next one is near; or after so long."""


@dataclass(frozen=True, slots=True)
class ServeAddresses:
    """Where everything listens."""

    commands: str = "tcp://127.0.0.1:5570"
    events: str = "tcp://127.0.0.1:5571"
    gateway: str = "tcp://127.0.0.1:5025"
    web: str = "http://127.0.0.1:5580"

    def sections(self) -> str:
        """What the rig file says of the servers."""
        return (
            f'\n[gateway]\naddress = "{self.gateway}"\n\n[web]\naddress = "{self.web}"\ntoken_file = "{TOKEN_FILE}"\n'
        )


def serve_demo(out: Path, text: str | None, addresses: ServeAddresses = ServeAddresses()) -> None:
    """Serve until a signal.

    Parameters
    ----------
    out
        Folder for everything.
    text
        A campaign's file; the endless one where it is None.

    Raises
    ------
    DemoFailed
        The daemon has ended, or a campaign did not complete.
    """
    write_durably(out / TOKEN_FILE, secrets.token_hex(16) + "\n")
    (out / TOKEN_FILE).chmod(0o600)
    click.echo(f"Starting the simulated rig and the daemon in {out} …")
    with laboratory(out, commands=addresses.commands, events=addresses.events, more=addresses.sections()) as lab:
        click.echo(f"Commands over HTTP need the token in {out / TOKEN_FILE}. The first envelope is on its way …")
        sys.stdout.flush()
        began_s, is_printed = time.monotonic(), False
        while True:
            for event in _campaign(lab, text or ENDLESS):
                is_due = event["kind"] == "envelope" or time.monotonic() > began_s + PATIENCE_S
                if not is_printed and is_due:
                    is_printed = True
                    _print_recipes(addresses)
                if event["kind"] == "envelope":
                    click.echo(f"envelope of {event['data']['capture']}")
                    sys.stdout.flush()


def _print_recipes(addresses: ServeAddresses) -> None:
    click.echo("Serving; Ctrl-C ends it. To join, paste into another terminal:\n")
    for title, lines in recipes(addresses).items():
        click.echo(f"# {title}\n{lines}")
    sys.stdout.flush()


def _campaign(lab: DemoLab, text: str) -> Iterator[dict[str, Any]]:
    """Submit a campaign; its events, and statuses among them, until it is completed."""
    submitted = lab.client.call("campaign.submit", toml=text)["campaign"]
    for event in lab.events():
        if event["kind"] == "status" or event["campaign"] == submitted:
            yield event
        if event["campaign"] == submitted and event["kind"] == "campaign.completed":
            return
        if event["campaign"] == submitted and event["kind"] in FAILED:
            raise DemoFailed(f"{event['kind']}: {event['data'].get('reason') or 'see the log'}")


def recipes(addresses: ServeAddresses) -> dict[str, str]:
    """Lines to paste, by what they join with; each prints the first envelope and ends."""
    labdaemon = "labdaemon" if shutil.which("labdaemon") else f"{shlex.quote(sys.executable)} -m labdaemon"
    host, _, port = addresses.gateway.removeprefix("tcp://").rpartition(":")
    return {
        "ZeroMQ and nothing else (pip install pyzmq)": f"""\
python3 - <<'END'
import json, zmq
events = zmq.Context().socket(zmq.SUB)
events.connect("{addresses.events}")
events.subscribe("envelope")
event = json.loads(events.recv_multipart()[1])
print(event["seq"], event["data"]["capture"], len(event["data"]["targets"]), "targets")
END
""",
        "HTTP (curl; a browser or Excel take the same addresses)": f"""\
curl -sN "{addresses.web}/events?after=0" | grep -m 1 -A 1 "event: envelope"
curl -s {addresses.web}/latest/envelope.csv
""",
        "VISA (pip install pyvisa pyvisa-py)": f"""\
python3 - <<'END'
import pyvisa
lab = pyvisa.ResourceManager("@py").open_resource("TCPIP::{host}::{port}::SOCKET", read_termination="\\n")
lab.write_termination, lab.timeout = "\\n", 60_000
print(lab.query("*IDN?"), lab.query("ENV:NEXT?").split(",")[:3])
END
""",
        "bluesky (pip install bluesky)": f"""\
{labdaemon} bridge bluesky --address {addresses.commands} --after 0 &
python3 - <<'END'; kill %1
from bluesky.callbacks.zmq import RemoteDispatcher
documents = RemoteDispatcher("127.0.0.1:5578")
def show(name, doc):
    print(doc["data"]["capture"], doc["data"].get("ax_mm", [])[:3])
    "ax_mm" in doc["data"] and documents.stop()
documents.subscribe(show, "event")
documents.start()
END
""",
        "MQTT (pip install 'labdaemon[mqtt]', apt-get install mosquitto mosquitto-clients)": f"""\
mosquitto -p 1884 >/dev/null 2>&1 &
sleep 1; {labdaemon} bridge mqtt --address {addresses.commands} --broker 127.0.0.1:1884 --after 0 &
mosquitto_sub -p 1884 -t labdaemon/envelope -C 1 | head -c 300
kill %1 %2
""",
    }
