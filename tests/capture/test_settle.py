from __future__ import annotations

import math
from dataclasses import replace

import pytest

from labdaemon.capture.devices import GaugeReading
from labdaemon.capture.settle import Excitation, is_steady, settling_time_s, wait_settled
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError
from labdaemon.testing.rig import fake_rig


def test_ring_time_is_that_of_the_free_vibration():
    # 5 Hz at 1 % damping: exp(-0.01 * 2 pi 5 t) = 1/1000 at 22 s
    assert settling_time_s(5.0, 0.01) == pytest.approx(21.99, abs=0.01)
    assert math.exp(-0.01 * 2 * math.pi * 5.0 * settling_time_s(5.0, 0.01)) == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("change", "value", "sd", "steady"), [(1e-4, 1.0, 1e-3, True), (0.01, 1.0, 1e-3, False), (0.5, 2e-3, 1e-3, True)]
)
def test_steady_is_little_change_or_nothing_to_settle(change: float, value: float, sd: float, steady: bool):
    assert is_steady(GaugeReading(value, sd, 0.0, change), 0.001) == steady


@pytest.mark.parametrize("damping", [0.005, 0.02])
def test_it_takes_as_long_as_the_structure_rings(damping: float):
    clock = SimulatedClock()
    fake = fake_rig(clock)
    fake.world.damping_ratio = damping

    async def main() -> float:
        fake.world.enabled, fake.world.heartbeat_at = True, 1e9
        fake.world.drive(True, 5.0, 1.0)
        return (await wait_settled(fake.rig, Excitation(5.0, 1.0, 1e-4, timeout_s=300.0), clock)).waited_s

    waited_s = clock.run(main())
    # change a cycle is 2 pi zeta times what is missing: 1e-4 is reached after ln(2 pi zeta / 1e-4) / (2 pi f zeta)
    expected_s = math.log(2 * math.pi * damping / 1e-4) / (2 * math.pi * 5.0 * damping)
    assert expected_s <= waited_s <= expected_s + 3.0


def test_without_a_gauge_the_whole_ring_time_is_waited():
    clock = SimulatedClock()
    rig = replace(fake_rig(clock).rig, gauges=())

    async def main() -> float:
        return (await wait_settled(rig, Excitation(5.0, 1.0, damping_ratio=0.02), clock)).waited_s

    assert clock.run(main()) == pytest.approx(settling_time_s(5.0, 0.02))


def test_what_never_settles_is_told_in_time():
    clock = SimulatedClock()
    fake = fake_rig(clock)
    fake.world.damping_ratio = 1e-4

    async def main() -> None:
        fake.world.enabled, fake.world.heartbeat_at = True, 1e9
        fake.world.drive(True, 5.0, 1.0)
        with pytest.raises(DeviceError, match=r"response: the structure has not settled within 20 s at 5 Hz"):
            await wait_settled(fake.rig, Excitation(5.0, 1.0, 1e-6, timeout_s=20.0), clock)

    clock.run(main())
    assert clock.monotonic() < 25.0
