"""Fakes for tests of drivers and of programs on top of the daemon: a rig without wires, and a laboratory around it.

`FakeRig` is a shaker table, cameras, gauges and a trigger in one process, on a clock of its own, with faults by name. A
`FakeLab` adds the journal, the engine and what lies between, all of them the real ones. Simulators that speak the real
wire protocols are in ``labdrivers.sim``.

``tests/campaign`` and ``tests/capture`` show how they are used. The guide for driver authors is
``docs/how-to/write-a-driver.md``.
"""

from labdaemon.testing.lab import FakeLab
from labdaemon.testing.rig import FakeRig, FakeWorld, fake_rig

__all__ = ["FakeLab", "FakeRig", "FakeWorld", "fake_rig"]
