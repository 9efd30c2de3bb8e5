"""When the readings of a stream were taken, as the arrivals of its blocks show it."""

import numpy as np
import pytest

from labdrivers.reading_times import ReadingTimes

RATE_HZ = 500.0


def stream(
    *, blocks: int = 100, size: int = 10, late_s: dict[int, float] | None = None, lost: dict[int, int] | None = None
) -> tuple[ReadingTimes, np.ndarray]:
    """A stream of blocks, and the true times of its readings; some blocks come late, some readings are lost before."""
    times, total, taken = ReadingTimes(RATE_HZ, 60.0), 0, 0
    truth: list[float] = []
    for block in range(blocks):
        taken += (lost or {}).get(block, 0)
        truth += [(taken + i) / RATE_HZ for i in range(size)]
        taken, total = taken + size, total + size
        times.note(total, truth[-1] + (late_s or {}).get(block, 0.0))
    return times, np.array(truth)


def test_a_steady_stream_has_the_times_of_its_readings() -> None:
    times, truth = stream()
    np.testing.assert_allclose(times.of_latest(1000), truth, atol=1e-9)
    np.testing.assert_allclose(times.of_latest(123), truth[-123:], atol=1e-9)


def test_a_delay_that_passes_moves_nothing() -> None:
    times, truth = stream(late_s={30: 0.3, 31: 0.28, 32: 0.26, 77: 0.02})
    np.testing.assert_allclose(times.of_latest(1000), truth, atol=1e-9)


def test_lost_readings_leave_a_gap() -> None:
    times, truth = stream(lost={40: 75})
    found = times.of_latest(1000)
    np.testing.assert_allclose(found, truth, atol=1e-9)
    assert np.diff(found).max() == pytest.approx(76 / RATE_HZ)


def test_times_ascend_whatever_comes_late() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        late = {block: float(rng.exponential(0.05)) for block in range(100)}
        times, _ = stream(late_s=late, lost={int(rng.integers(100)): int(rng.integers(200))})
        assert np.all(np.diff(times.of_latest(1000)) > 0)


def test_nothing_came() -> None:
    assert ReadingTimes(RATE_HZ, 1.0).of_latest(10).size == 0


def test_arrivals_are_forgotten_with_their_readings() -> None:
    times = ReadingTimes(RATE_HZ, 0.1)
    for total in range(1, 400):
        times.note(total, total / RATE_HZ)
    np.testing.assert_allclose(np.diff(times.of_latest(50)), 1 / RATE_HZ, atol=1e-9)
