"""Text gateway and HTTP in the daemon itself: each way to trigger a capture says what it knows of it."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labdaemon.cli.remote import capture
from labdaemon.errors import ConfigError
from labdaemon.service.config import load_rig

TOKEN = "0123456789abcdef-operator"
STATED = {"frequency_hz": 6.0, "excitation_amplitude_mm": 0.5, "phase_rad": 1.5, "exposure_s": 0.25}


@pytest.fixture
def token_file(config: Path) -> Path:
    path = config.parent / "web.token"
    path.write_text(TOKEN)
    path.chmod(0o600)
    return path


def add_sections(config: Path, text: str) -> None:
    config.write_text(config.read_text() + text)


@pytest.mark.slow
def test_captures_by_every_way_in(
    config: Path, tmp_path: Path, daemons: list[Any], start_daemon: Callable[..., Any], token_file: Path
):
    pytest.importorskip("uvicorn", reason="uvicorn is not installed (extra web)")
    add_sections(
        config,
        '\n[gateway]\naddress = "tcp://127.0.0.1:*"\n[web]\naddress = "http://127.0.0.1:*"\ntoken_file = "web.token"\n',
    )
    daemons.append(start_daemon(config, tmp_path / "data"))
    daemon = daemons[-1].ready()
    service = daemon.ask("rig")["service"]
    daemon.ask("capture", sharp=True, exposure_s=0.25)

    by_rpc = daemon.ask("capture", label="rpc", group="g1", **STATED)["capture"]
    by_text = capture_by_text(service["gateway"])
    options = ["--frequency-hz", "6", "--excitation-amplitude-mm", "0.5", "--phase-rad", "1.5", "--exposure-s", "0.25"]
    options += ["--group", "g4", "--label", "cli", "--json", "--address", daemon.addresses["commands"]]
    by_cli = json.loads(CliRunner().invoke(capture, options).output)["capture"]
    request = urllib.request.Request(
        f"{service['web']}/command/capture",
        json.dumps({"label": "web", "group": "g3", **STATED}).encode(),
        {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"},
    )
    with urllib.request.urlopen(request, timeout=300) as answer:
        by_web = json.load(answer)["result"]["capture"]

    wanted = {by_rpc: ("rpc", "g1"), by_text: ("text", "g2"), by_web: ("web", "g3"), by_cli: ("cli", "g4")}
    seen: dict[str, Any] = {}
    with urllib.request.urlopen(f"{service['web']}/events?after=0", timeout=300) as stream:
        while len(seen) < 5:
            line = stream.readline()
            if line.startswith(b"data: ") and b'"capture.completed"' in line:
                event = json.loads(line[6:])
                seen[event["data"]["capture"]] = event["data"]
        for name, (label, group) in wanted.items():
            data = seen[name]
            assert (data["label"], data["group"]) == (label, group)
            assert {key: data[key] for key in STATED} == pytest.approx(STATED, rel=1e-6)
        # A stream that is being read does not hold up the end.
        assert daemon.end()[0] == 0


def capture_by_text(address: str) -> str:
    """`TRIG` on the text gateway; the capture's name."""
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    with socket.create_connection((host, int(port)), timeout=300) as client:
        client.sendall(
            b'CAPT:FREQ 6 HZ;AMPL 0.5 MM;PHAS 1.5;EXP 250 MS;GRO "g2";LAB "text"\nTRIG;CAPT?;:STAT?;:SYST:ERR?\n'
        )
        answer = client.makefile().readline().split(";")
    assert answer[1].startswith("IDLE,")
    assert answer[2].strip() == '0,"No error"'
    return answer[0].split(",")[0].strip('"')


@pytest.mark.parametrize(
    ("section", "wrong"),
    [
        ('[gateway]\naddress = "tcp://0.0.0.0:5025"', "off loopback"),
        ('[web]\naddress = "http://192.168.1.5:80"', "off loopback"),
        ('[web]\naddress = "https://127.0.0.1:80"', "is no address"),
        ('[gateway]\naddress = "tcp://127.0.0.1:99999"', "is no address"),
        ('[gateway]\ntoken_file = "absent"', "cannot be read"),
        ('[gateway]\ntoken_file = "open"', "chmod 600"),
        ('[gateway]\ntoken_file = "short"', "openssl"),
        ("[gateway]\ntoken = 1", "unknown key|token"),
        ('[web]\nhosts = ["a b"]', "hosts"),
    ],
)
def test_sections_that_are_refused(config: Path, section: str, wrong: str):
    (config.parent / "open").write_text(TOKEN)
    (config.parent / "short").write_text("secret\n")
    (config.parent / "short").chmod(0o600)
    add_sections(config, f"\n{section}\n")
    with pytest.raises(ConfigError, match=wrong):
        load_rig(config)


FILES = 'commands = "ipc:///run/c"\nevents = "ipc:///run/e"\n'


@pytest.mark.parametrize(
    ("service", "policy"),
    [
        ('local_operators = "keys"\n', "keys"),
        (FILES, "owner"),
        (FILES + 'local_operators = "group:lab"\n', "group:lab"),
        ('events = "tcp://0.0.0.0:5571"\n', "keys"),
        (FILES + 'local_operators = "all"\n', "all"),
        ("", "all"),
    ],
)
@pytest.mark.parametrize("section", ["gateway.token_file", "web.observer_token_file"])
def test_no_other_way_in_is_wider_than_the_policy(
    config: Path, token_file: Path, service: str, policy: str, section: str
):
    name, key = section.split(".")
    text = re.sub(r"(?m)^(commands|events) *=.*\n", "", config.read_text())
    config.write_text(text.replace("[service]\n", f"[service]\n{service}") + f"\n[{name}]\n")
    if policy == "all":
        assert not load_rig(config).service.restricts_operators
        return
    with pytest.raises(ConfigError, match=f"local_operators is {policy} here") as refused:
        load_rig(config)
    assert refused.value.key == section
    add_sections(config, f'{key} = "{token_file.name}"\n')
    assert load_rig(config).service.local_policy == policy


def test_web_without_its_packages_is_refused_with_what_to_install(config: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("labdaemon.service.config.find_spec", lambda name: None)
    add_sections(config, "\n[web]\n")
    with pytest.raises(ConfigError, match=r"pip install 'labdaemon\[web\]'"):
        load_rig(config)


def test_servers_change_no_results(config: Path, token_file: Path):
    before = load_rig(config).digest
    add_sections(config, '\n[gateway]\naddress = "tcp://0.0.0.0:5025"\ntoken_file = "web.token"\n')
    assert load_rig(config).digest == before


def test_nothing_of_the_web_is_loaded_without_its_section():
    code = "import sys, labdaemon.cli.main, labdaemon.cli.remote, labdaemon.service.serve; "
    code += "sys.exit(bool({'uvicorn', 'starlette', 'paho', 'labdaemon.web'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], timeout=300, check=False).returncode == 0
