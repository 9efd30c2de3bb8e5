"""The simulated rig as a process of its own, which outlives the daemon as real hardware does.

``python -m labdrivers.sim.server`` prints one line of JSON with its addresses and runs until a signal, its parent's end
(standard input closes) or ``quit``. `start` does that from a program: it is the entry point ``rig`` of
``labdaemon.simulators``.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from labdrivers.sim.assembly import SimulatedRig
from labdrivers.sim.control import ControlClient, ControlCommands, ControlServer
from labdrivers.sim.modification import MODIFICATIONS, modified_modes
from labdrivers.sim.rig_file import write_rig_files
from labdrivers.sim.spec import RigSpec
from labdrivers.sim.usb_remote import BusServer
from labdrivers.sim.wire import TcpPort

START_S = 30.0
SMALL_FRAME = (64, 48)


@dataclass(frozen=True, slots=True)
class Addresses:
    """Where the devices of a running rig are.

    Attributes
    ----------
    ports
        Serial device -> port for the rig file (``shaker``, ``trigger``, ``gauge-table``, ``gauge-response``).
    backend, backend_url
        For ``[cameras.*]``.
    control
        The back door, see `ControlClient`.
    """

    ports: dict[str, str]
    backend: str
    backend_url: str
    control: str


class RunningRig:
    """A rig in a child process.

    Parameters
    ----------
    process
        The child, its standard input a pipe that keeps it alive.
    addresses
        As it printed them.
    spec
        What it simulates.
    """

    def __init__(self, process: subprocess.Popen[str], addresses: Addresses, spec: RigSpec) -> None:
        self._process, self.addresses, self.spec = process, addresses, spec
        self.control = ControlClient(addresses.control)

    @property
    def pid(self) -> int:
        """Of the child."""
        return self._process.pid

    def truth(self) -> list[dict[str, Any]]:
        """What every target did in every exposure so far: camera, opened_at (RFC 3339), opened_s, targets …"""
        found: list[dict[str, Any]] = self.control.ask("records")
        return found

    def modes(self) -> list[dict[str, float]]:
        """Natural frequencies and damping ratios of the simulated structure, for comparisons only."""
        return [
            {"frequency_hz": mode.frequency_hz, "damping": mode.damping_ratio}
            for mode in sorted(self.spec.modes, key=lambda mode: mode.frequency_hz)
        ]

    def table(self) -> dict[str, Any]:
        """Whether the table is ``moving`` now, its ``frequency_hz``, whether ``enabled``, why ``tripped``."""
        found: dict[str, Any] = self.control.ask("table")
        return found

    def inject(self, device: str, fault: str, *, count: int | None = None, value: float | None = None) -> None:
        """Switch a fault on; ``control.ask("faults")`` lists them."""
        self.control.ask("inject", device=device, fault=fault, count=count, value=value)

    def clear(self, device: str | None = None, fault: str | None = None) -> None:
        """Switch faults off."""
        self.control.ask("clear", device=device, fault=fault)

    def rig_file(self, rig: dict[str, Any]) -> dict[str, Any]:
        """A rig file's content (parsed TOML) with the ports of this rig in the place of its own."""
        changed = json.loads(json.dumps(rig))
        for section in ("shaker", "trigger"):
            if section in changed:
                changed[section]["port"] = self.addresses.ports[section]
        for gauge in changed.get("gauge", []):
            gauge["port"] = self.addresses.ports[f"gauge-{gauge.get('role', gauge.get('name'))}"]
        for camera in changed.get("cameras", {}).values():
            camera["backend"], camera["backend_url"] = self.addresses.backend, self.addresses.backend_url
        return dict(changed)

    def write_files(self, folder: Path, *, events: str, commands: str, data: str) -> Path:
        """Write the rig file that reaches this rig, with its survey, into a folder; returns the rig file's path.

        The daemon writes no page of a campaign then: who runs a simulated rig compares with what it did.
        """
        reached = {"backend": self.addresses.backend, "backend_url": self.addresses.backend_url}
        return write_rig_files(
            folder,
            self.spec,
            ports=self.addresses.ports,
            camera_settings=reached,
            events=events,
            commands=commands,
            data=data,
            reports=False,
        )

    def close(self) -> None:
        """End it."""
        self.control.close()
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> RunningRig:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def start(
    *,
    seed: int = 1,
    small: bool = False,
    cards: Path | None = None,
    enable_wired: bool = True,
    modification: str = "none",
) -> RunningRig:
    """Start the simulated rig in a process of its own and wait until it can be talked to.

    Parameters
    ----------
    seed
        Of paper texture, noise and survey errors.
    small
        Frames of 64 × 48 pixels that take no time, for tests of everything but the measurement.
    cards
        Directory for the cameras' cards; temporary ones if None.
    enable_wired
        Whether the amplifier needs the trigger box's enable line.
    modification
        Of the structure, a name of `labdrivers.sim.modification.MODIFICATIONS`.

    Raises
    ------
    RuntimeError
        It did not come up.
    """
    command = [sys.executable, "-P", "-m", "labdrivers.sim.server", "--follow-stdin", "--seed", str(seed)]
    command += ["--small"] if small else []
    command += ["--cards", str(cards)] if cards is not None else []
    command += [] if enable_wired else ["--enable-not-wired"]
    command += ["--modification", modification]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    timer = threading.Timer(START_S, process.kill)
    timer.start()
    line = process.stdout.readline()
    timer.cancel()
    if not line.strip():
        process.kill()
        raise RuntimeError(f"the simulated rig did not start (exit status {process.wait()})")
    return RunningRig(process, Addresses(**json.loads(line)), _spec(seed, small, modification))


def _spec(seed: int, small: bool, modification: str = "none") -> RigSpec:
    spec = RigSpec(seed=seed, modes=modified_modes(MODIFICATIONS[modification]))
    if small:
        spec = replace(spec, cameras={name: replace(c, image_size=SMALL_FRAME) for name, c in spec.cameras.items()})
    return spec


def main(arguments: list[str] | None = None) -> int:
    """Run the rig in this process until a signal or the control command ``quit`` ends it."""
    parser = argparse.ArgumentParser(prog="python -m labdrivers.sim.server", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of paper texture, noise and survey errors")
    parser.add_argument("--small", action="store_true", help="frames of 64 x 48 pixels that take no time")
    parser.add_argument("--cards", type=Path, help="directory for the cameras' cards")
    parser.add_argument("--enable-not-wired", action="store_true", help="amplifier runs without the enable line")
    parser.add_argument("--modification", choices=list(MODIFICATIONS), default="none", help="of the structure")
    parser.add_argument("--follow-stdin", action="store_true", help="end when standard input closes")
    options = parser.parse_args(arguments)
    spec = _spec(options.seed, options.small, options.modification)
    ended, stop = _end_on_signals()
    rig = SimulatedRig(spec, cards=options.cards, enable_wired=not options.enable_not_wired)
    ports = {name: TcpPort(device) for name, device in rig.wires.items()}
    bus, control = BusServer(rig.bus), ControlServer(ControlCommands(rig, stop))
    urls = {name: port.url for name, port in ports.items()}
    addresses = {"ports": urls, "backend": "sim-remote", "backend_url": bus.url, "control": control.url}
    print(json.dumps(addresses), flush=True)
    if options.follow_stdin:
        threading.Thread(target=_wait_for_end, args=(stop,), daemon=True).start()
    os.read(ended, 1)
    rig.shut_down()
    os._exit(0)  # connections' threads need no farewell


def _end_on_signals() -> tuple[int, Callable[[], None]]:
    """A descriptor that becomes readable when the rig is to end, and a function that ends it as SIGINT and SIGTERM do.

    The interpreter's low-level handler writes to it, in whichever thread the kernel chose to interrupt. A handler in
    Python would not do: it runs in the main thread only, which reads; a signal to another thread, or in the moment
    before the read begins, leaves it reading for ever.
    """
    ended, end = os.pipe()
    os.set_blocking(end, False)
    signal.set_wakeup_fd(end, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)

    def stop() -> None:
        with suppress(BlockingIOError):  # full of reasons already
            os.write(end, b".")

    return ended, stop


def _wait_for_end(stop: Callable[[], None]) -> None:
    while os.read(0, 4096):
        pass
    stop()


if __name__ == "__main__":
    sys.exit(main())
