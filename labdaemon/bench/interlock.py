"""`labdaemon bench interlock`: from an interlock's trip to the shaker's first stop command on the wire.

The monitor, the table, the lines and the drivers are the daemon's own; the rig is simulated in a process of its own; a
proxy in the shaker's wire notes when which command passes. Half of the trips come while the shaker is still ramping.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import shutil
import statistics
import tempfile
import threading
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from socket import create_connection, create_server, socket
from typing import Any

import click

from labdaemon.bench.kill import small_rig
from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.interlock_monitor import InterlockMonitor
from labdaemon.campaign.interlocks import InterlockLimits
from labdaemon.campaign.run_control import RunControl
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.device_executor import ThreadExecutor
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table
from labdaemon.clock import SystemClock
from labdaemon.errors import LabdaemonError
from labdaemon.journal.journal import Journal
from labdaemon.service.config import load_rig
from labdaemon.service.devices import build_rig, connect_others, connect_stop_actuators

COMMAND = re.compile(rb"OUTP[A-Z]*\s+(?P<off>OFF|0)|VOLT[A-Z]*\s+(?P<level>[0-9.eE+-]+)", re.IGNORECASE)
"""What brings the table down: output off, or a smaller level than the one before."""


@dataclass(slots=True)
class RecordingProxy:
    """Stands in a TCP wire and notes when commands pass.

    Attributes
    ----------
    passed
        Monotonic time and bytes of everything that went to the device.
    """

    host: str
    port: int
    passed: list[tuple[float, bytes]] = field(default_factory=list)

    def start(self) -> str:
        """Serve one connection after the other; the URL to put into the rig file."""
        server = create_server(("127.0.0.1", 0))
        threading.Thread(target=self._serve, args=(server,), daemon=True).start()
        return f"socket://127.0.0.1:{server.getsockname()[1]}"

    def first_stop_after(self, moment_s: float) -> float | None:
        """When the first stopping command after a moment passed."""
        level = 0.0
        for at_s, data in self.passed:
            for found in COMMAND.finditer(data):
                is_off, before = found["off"] is not None, level
                level = 0.0 if is_off else float(found["level"])
                if at_s >= moment_s and (is_off or level < before):
                    return at_s
        return None

    def _serve(self, server: socket) -> None:
        while True:
            client, _ = server.accept()
            device = create_connection((self.host, self.port))
            threading.Thread(target=self._pump, args=(device, client, False), daemon=True).start()
            threading.Thread(target=self._pump, args=(client, device, True), daemon=True).start()

    def _pump(self, source: socket, sink: socket, noted: bool) -> None:
        try:
            while data := source.recv(4096):
                if noted:
                    self.passed.append((time.monotonic(), data))
                sink.sendall(data)
        except OSError:  # the run is over, and its wire is closed
            return
        finally:
            sink.close()


@dataclass(frozen=True, slots=True)
class StopLatencies:
    """Seconds from trip to first stop command on the wire."""

    settled_s: tuple[float, ...]
    ramping_s: tuple[float, ...]

    @property
    def p99_s(self) -> float:
        """99th percentile of all."""
        everything = sorted(self.settled_s + self.ramping_s)
        return everything[min(int(0.99 * len(everything)), len(everything) - 1)]


async def measure(rig_file: Path, proxy: RecordingProxy, data: Path, trips: int) -> StopLatencies:
    """Trip the response interlock again and again.

    Parameters
    ----------
    rig_file
        Of the rig, its shaker behind `proxy`.
    trips
        How often, half of them in mid-ramp.
    """
    clock, rig = SystemClock(), build_rig(load_rig(rig_file))
    await connect_stop_actuators(rig)
    table = Table(rig, clock, None)
    await table.stop(at_once=True)
    await connect_others(rig)
    journal = Journal(data, clock)
    context = AcquisitionContext(rig, table, Recorder(journal, ThreadExecutor("journal")), clock, data)
    tripped: list[float] = []
    stopped: list[asyncio.Task[Any]] = []

    class StopOnTrip:
        """Stops the table, with no engine in between."""

        def trip(self, error: LabdaemonError) -> None:
            if not tripped and table.excitation is not None:
                tripped.append(time.monotonic())
                stopped.append(asyncio.create_task(table.stop()))

        def oldest_s(self) -> float:
            return 0.0  # nothing is measured here

    observer = StopOnTrip()

    disk = DataDisk(context.recorder, lambda: 1 << 40, 0)
    monitor = InterlockMonitor(context, InterlockLimits(), observer, disk=disk, backlog=observer, control=RunControl())
    watching = asyncio.create_task(monitor.run())
    found: dict[bool, list[float]] = {False: [], True: []}
    try:
        for number in range(trips):
            ramping = number % 2 == 1
            tripped.clear()
            stopped.clear()
            monitor.limits = InterlockLimits(gauge_disagreement=None)
            excitation = Excitation(6.0, 4.0 if ramping else 0.5, max_change_per_cycle=1.0, timeout_s=5.0)
            shaking = asyncio.create_task(table.shake(excitation))
            if ramping:
                await asyncio.sleep(0.4)
            else:
                await shaking
            monitor.limits = replace(monitor.limits, max_response_mm=1e-6)
            while not stopped:
                await asyncio.sleep(0.005)
            await asyncio.gather(*stopped)
            await asyncio.gather(shaking, return_exceptions=True)
            at_s = proxy.first_stop_after(tripped[0])
            if at_s is None:
                raise LabdaemonError("no stop command passed the wire")
            found[ramping].append(at_s - tripped[0])
    finally:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await table.stop(at_once=True)
        await rig.close()
        journal.close()
    return StopLatencies(tuple(found[False]), tuple(found[True]))


def run(trips: int, seed: int) -> StopLatencies:
    """The whole of it, in a folder of its own."""
    folder = Path(tempfile.mkdtemp(prefix="labdaemon-interlock-"))
    try:
        with small_rig(seed) as rig:
            host, port = rig.addresses.ports["shaker"].removeprefix("socket://").split(":")
            proxy = RecordingProxy(host, int(port))
            events, commands = "tcp://127.0.0.1:5571", "tcp://127.0.0.1:5570"  # named in the file, never bound
            config = rig.write_files(folder, events=events, commands=commands, data=str(folder / "data"))
            config.write_text(config.read_text().replace(rig.addresses.ports["shaker"], proxy.start()))
            return asyncio.run(measure(config, proxy, folder / "data", trips))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@click.command("interlock")
@click.option("--trips", type=click.IntRange(2), default=100, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(trips: int, seed: int, as_json: bool) -> None:
    """Time from an interlock's trip to the shaker's stop command."""
    logging.getLogger("labdaemon").addHandler(logging.NullHandler())
    found = run(trips, seed)
    rows = {"settled": found.settled_s, "in mid-ramp": found.ramping_s}
    if as_json:
        click.echo(json.dumps({**{name: list(values) for name, values in rows.items()}, "p99_s": found.p99_s}))
    else:
        click.echo("| table | trips | median | largest |\n|---|---|---|---|")
        for name, values in rows.items():
            click.echo(
                f"| {name} | {len(values)} | {1e3 * statistics.median(values):.1f} ms | {1e3 * max(values):.1f} ms |"
            )
        click.echo(f"| both, 99th percentile | {trips} | {1e3 * found.p99_s:.1f} ms | |")
    if found.p99_s > 0.1:
        raise SystemExit(1)
