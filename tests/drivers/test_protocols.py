"""Every driver that an entry point names fulfils its Protocol, opens nothing when built, and is safe to close."""

from __future__ import annotations

from importlib.metadata import entry_points

import pytest

from labdaemon.capture.devices import Camera, Gauge, Shaker, Trigger
from labdaemon.errors import TransportError

LIMITS = {"stroke_mm": 150, "velocity_mm_s": 1000, "acceleration_mm_s2": 20000, "frequency_hz": [1, 50]}
DRIVERS = {
    ("labdaemon.shakers", "scpi"): (
        Shaker, {"port": "/dev/nowhere", "limits": LIMITS, "drive": [{"frequency_hz": 5, "mm_per_v": 1}]},
        [("set", 5.0, 1.0), ("state",), ("stop",), ("stop_now",)],
    ),
    ("labdaemon.triggers", "box"): (
        Trigger, {"port": "/dev/nowhere"}, [("fire", 1.0), ("wait", 0.1), ("heartbeat",), ("drop_enable",)],
    ),
    ("labdaemon.triggers", "rts"): (
        Trigger, {"port": "/dev/nowhere"}, [("fire", 1.0), ("wait", 0.1), ("heartbeat",)],
    ),
    ("labdaemon.cameras", "ptp"): (
        Camera, {"serial": "1"}, [("configure",), ("exposure_steps_s",), ("status",), ("wait_file", 0.1), ("files",)],
    ),
    ("labdaemon.gauges", "line"): (Gauge, {"port": "/dev/nowhere"}, []),
}  # fmt: skip


@pytest.mark.parametrize(("group", "name"), DRIVERS)
def test_driver(group, name):
    protocol, settings, calls = DRIVERS[group, name]
    (entry,) = entry_points(group=group, name=name)
    driver = entry.load()("thing", {"driver": name, **settings})
    assert isinstance(driver, protocol)
    assert driver.name == "thing"
    assert set(settings) <= entry.load().SETTINGS
    for method, *arguments in calls:
        # What stops the table opens a closed wire by itself; everything else wants `connect` first.
        expected = "does not open" if method in ("stop_now", "drop_enable") else "not connected; connect first"
        with pytest.raises(TransportError, match=f"thing: .*{expected}"):
            getattr(driver, method)(*arguments)
    driver.close()
    driver.close()
