"""A daemon on a small simulated rig, with text gateway and web server, and a wire whose commands are noted."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labdaemon.bench.interlock import RecordingProxy
from labdaemon.bench.kill import small_rig
from labdaemon.stream.client import Client

END_S = 60.0


@dataclass(frozen=True, slots=True)
class ServedDaemon:
    """It, and where it listens.

    Attributes
    ----------
    process, folder
        The daemon's own.
    trigger
        Stands in the trigger box's wire.
    commands, events, gateway, web
        Addresses.
    token
        An operator's.
    """

    process: subprocess.Popen[str]
    folder: Path
    trigger: RecordingProxy
    commands: str
    events: str
    gateway: str
    web: str
    token: str

    def memory_mb(self) -> float:
        """What it holds now."""
        found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{self.process.pid}/status").read_text())
        return int(found[1]) / 1024.0 if found else 0.0

    def log_lines(self) -> list[dict[str, Any]]:
        """Its log so far."""
        text = (self.folder / "daemon.log").read_text(errors="replace")
        return [json.loads(line) for line in text.splitlines() if line.startswith("{")]

    def connect(self, address: str) -> socket.socket:
        """A TCP connection to one of its addresses."""
        host, _, port = address.partition("://")[2].rpartition(":")
        return socket.create_connection((host, int(port)), timeout=10.0)


@contextmanager
def served_daemon(seed: int) -> Iterator[ServedDaemon]:
    """Start it, its journal in memory where the system has such a folder; at the end it is gone."""
    shared = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-stream-", dir=shared))
    try:
        with small_rig(seed) as rig:
            host, _, port = rig.addresses.ports["trigger"].removeprefix("socket://").rpartition(":")
            trigger = RecordingProxy(host, int(port))
            free, token = "tcp://127.0.0.1:*", secrets.token_hex(16)
            config = rig.write_files(folder, events=free, commands=free, data=str(folder / "data"))
            (folder / "token").write_text(token)
            (folder / "token").chmod(0o600)
            config.write_text(
                config.read_text().replace(rig.addresses.ports["trigger"], trigger.start())
                + '\n[gateway]\naddress = "tcp://127.0.0.1:*"\n'
                '[web]\naddress = "http://127.0.0.1:*"\ntoken_file = "token"\n'
            )
            command = [sys.executable, "-P", "-m", "labdaemon", "run", str(config), "--json"]
            with (folder / "daemon.log").open("w") as log:
                process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
            try:
                assert process.stdout is not None
                commands = json.loads(process.stdout.readline())["commands"]
                with Client(commands, timeout_s=60.0) as client:
                    service = client.call("rig")["service"]
                addresses = (commands, service["events"], service["gateway"], service["web"])
                yield ServedDaemon(process, folder, trigger, *addresses, token)
            finally:
                process.terminate()
                process.wait(END_S)
                assert process.stdout is not None
                process.stdout.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
