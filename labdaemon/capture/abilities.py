"""What a driver may offer in addition to its Protocol in `labdaemon.capture.devices`; a lab's own driver may too.

Each ability is a Protocol, found by `isinstance`. What a driver does not say of itself has the default that costs
nothing but a question more.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class GaugeRecord:
    """Readings of a gauge over a window of time.

    Attributes
    ----------
    t_s
        (n,) when each was taken, seconds after the window's start, ascending. Readings that were lost leave a gap.
    values
        (n,) in the gauge's own unit; NaN for one without a number.
    sd_t_s
        Standard deviation of all these times together against the host's clock: what a wire may delay.
    """

    t_s: NDArray[np.float64]
    values: NDArray[np.float64]
    sd_t_s: float = 0.0


@runtime_checkable
class RecordSource(Protocol):
    """A gauge driver that keeps its latest readings and the times of their arrival."""

    def record(self, *, start_s: float, duration_s: float) -> GaugeRecord:
        """Readings of a window that begins at a time of the host's monotonic clock; waits for its end if need be.

        Raises
        ------
        DeviceError
            The gauge fell silent, or sends what are no readings.
        """
        ...


@runtime_checkable
class AmplitudeTrimmer(Protocol):
    """A shaker driver whose amplitude is corrected by what the table gauge reads."""

    def trim(self, factor: float) -> None:
        """Correct the calibration at the present frequency: the table moves `factor` times what was set.

        Raises
        ------
        DeviceError
            The factor is more than a calibration can be wrong by, or the device did not take it.
        """
        ...


@runtime_checkable
class ExcitationChecker(Protocol):
    """A shaker driver that knows before it is connected what its device can do."""

    def check(self, frequency_hz: float, amplitude_mm: float) -> None:
        """Raise what `Shaker.set` would raise for this excitation; sends nothing."""
        ...


@runtime_checkable
class SettingsSource(Protocol):
    """A driver class that names the keys of its section, so that a typo in the rig file is refused."""

    SETTINGS: ClassVar[Collection[str]]


@runtime_checkable
class EnableLineHolder(Protocol):
    """A trigger driver that says whether its device holds the amplifier's enable line."""

    holds_enable: bool


@runtime_checkable
class OutputSwitch(Protocol):
    """A shaker driver that says whether its device switches its output off by itself."""

    can_switch_off: bool


@runtime_checkable
class AmplifierStatusSource(Protocol):
    """A shaker driver that says whether its device reports the state of the amplifier."""

    reports_amplifier: bool


@runtime_checkable
class WireReopener(Protocol):
    """A driver that says whether it opens a broken wire anew by itself, within a stop."""

    reopens: bool


def holds_enable_line(trigger: object) -> bool:
    """Whether a trigger driver's device holds an enable line; assumed where the driver does not say."""
    return bool(trigger.holds_enable) if isinstance(trigger, EnableLineHolder) else True


def can_switch_off(shaker: object) -> bool:
    """Whether a shaker driver's device switches its output off; assumed where the driver does not say."""
    return bool(shaker.can_switch_off) if isinstance(shaker, OutputSwitch) else True


def reports_amplifier(shaker: object) -> bool:
    """Whether a shaker driver's device reports its amplifier; only where the driver says so."""
    return isinstance(shaker, AmplifierStatusSource) and bool(shaker.reports_amplifier)


def reopens_wire(driver: object) -> bool:
    """Whether a driver opens a broken wire anew by itself; only where it says so."""
    return isinstance(driver, WireReopener) and bool(driver.reopens)
