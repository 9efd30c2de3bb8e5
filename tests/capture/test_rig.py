from __future__ import annotations

import pytest

from labdaemon.capture.device_executor import ThreadExecutor
from labdaemon.capture.rig import DeviceHandle
from labdaemon.errors import DeviceRefused, DriverFault


class Clumsy:
    """A driver that raises what it should not."""

    name = "left"

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def status(self) -> None:
        raise self.error


@pytest.mark.parametrize(
    "error",
    [
        UnicodeDecodeError("utf-8", b"\xe9", 0, 1, "invalid start byte"),
        KeyError("battery"),
        StopIteration(),
        SystemExit(2),
        RecursionError(),
        MemoryError(),
        OSError(28, "No space left on device"),
    ],
)
async def test_whatever_a_driver_raises_is_its_device_s_fault(error: BaseException):
    device = DeviceHandle(Clumsy(error), ThreadExecutor("left"))
    for call in (device.call, device.urgent):
        with pytest.raises(DriverFault, match="left: its driver failed") as caught:
            await call(lambda driver: driver.status(), 5.0)
        assert caught.value.retryable
        assert caught.value.device == "left"
    device.executor.close()


async def test_an_error_of_ours_stays_as_it_is():
    device = DeviceHandle(Clumsy(DeviceRefused("said no", device="left")), ThreadExecutor("left"))
    with pytest.raises(DeviceRefused, match="said no"):
        await device.call(lambda driver: driver.status(), 5.0)
    device.executor.close()
