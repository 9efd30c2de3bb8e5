"""Valleys of the phase between the phases of a profile."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.phase.valleys import valleys_between

PHASES = 2 * np.pi * np.arange(16) / 16


def profile(places: list[float], sd_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cost on a slope with narrow valleys in it, its derivative, and the minima that the phases show."""

    def cost(phase: np.ndarray) -> np.ndarray:
        away = [np.angle(np.exp(1j * (phase - place))) for place in places]
        return 400 * (1 - np.cos(phase)) - sum(300 * np.exp(-((one / sd_rad) ** 2) / 2) for one in away)

    values, slopes = cost(PHASES), (cost(PHASES + 1e-5) - cost(PHASES - 1e-5)) / 2e-5
    return values, slopes, np.flatnonzero((values <= np.roll(values, 1)) & (values <= np.roll(values, -1)))


def test_a_valley_between_two_phases_on_its_walls_is_found() -> None:
    cost, slopes, minima = profile([2.2], 0.1)
    assert list(minima) == [0]
    ((index, phase),) = valleys_between(PHASES, cost, slopes, minima)
    assert PHASES[5] < phase < PHASES[6]
    assert index in (5, 6)


def test_minima_that_the_phases_show_are_not_followed_twice() -> None:
    cost, slopes, minima = profile([PHASES[6]], 0.2)
    assert 6 in minima
    assert valleys_between(PHASES, cost, slopes, minima) == []
