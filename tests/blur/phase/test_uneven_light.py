"""Light that nothing states: seen where a lamp follows the excitation, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur import Defocus, Dot, fit_sharp, measure_frame
from labdaemon.blur.phase.shared_waveform import SharedWaveform, estimate_waveform
from labdaemon.blur.phase.uneven_light import is_light_uneven
from labdaemon.blur.phase.window_evidence import WaveformEvidence, collect_evidence
from labdaemon.flags import Flag

STILL = Defocus(0.0, 0.02)
VECTORS = ((2.0, 1.0), (-2.0, 5.0), (1.0, 1.6))
PHASES = (0.4, 2.1, 4.5)
Angles = Callable[[np.ndarray], np.ndarray]


def steady(share: np.ndarray) -> np.ndarray:
    return 2 * np.pi * share


def under(code: str) -> Angles:
    """Phase of the cycle against the share of the light that has come."""
    lit = [k for k, one in enumerate(code) if one == "1"]

    def angle(share: np.ndarray) -> np.ndarray:
        place = np.minimum((share * len(lit)).astype(int), len(lit) - 1)
        return 2 * np.pi * (np.take(lit, place) + share * len(lit) - place) / len(code)

    return angle


def shares_of(area, angle: Angles, second: float = 0.0):  # type: ignore[no-untyped-def]
    """What three dots share, each at its own phase; ``second`` is a second harmonic over the fundamental."""
    scene = area.Scene()
    sharps, patches = [], []
    for index, ((vx, vy), phase) in enumerate(zip(VECTORS, PHASES, strict=True)):

        def path(t, vx=vx, vy=vy, phase=phase):  # type: ignore[no-untyped-def]
            at = angle(np.asarray(t)) + phase
            course = np.sin(at) + second * np.sin(2 * at)
            return vx * course, vy * course

        place = (34.2 - 0.3 * index, 33.4)
        still = area.render(scene, (68, 68), place, seed=50 + index)
        sharps.append(fit_sharp(Dot(*place, 15.7, 15.7, 0.0, name=f"T{index}"), [still], noise=scene.noise))
        patches.append(area.render(scene, (68, 68), place, path, seed=90 + index, samples=112))
    first = measure_frame(sharps, patches, defocus=STILL)
    return sharps, patches, first


@pytest.mark.parametrize("code", ["1110100", "110100", "10"])
def test_a_lamp_that_follows_the_excitation_is_seen(area, code: str) -> None:  # type: ignore[no-untyped-def]
    found = estimate_waveform(*shares_of(area, under(code)), defocus=STILL, whole=True)
    assert found == SharedWaveform(is_light_uneven=True)


@pytest.mark.parametrize("second", [0.0, 0.03])
def test_constant_light_is_not_called_uneven(area, second: float) -> None:  # type: ignore[no-untyped-def]
    found = estimate_waveform(*shares_of(area, steady, second), defocus=STILL, whole=True)
    assert not found.is_light_uneven


def test_what_hides_a_part_of_one_target_is_no_light(area) -> None:  # type: ignore[no-untyped-def]
    bright, dark = (
        collect_evidence(*shares_of(area, angle), defocus=STILL)[:2] for angle in (steady, under("1110100"))
    )
    assert is_light_uneven(dark)
    assert not is_light_uneven([*bright, dark[0]])
    alone: WaveformEvidence = replace(dark[0], flags=frozenset())
    assert is_light_uneven([alone])
    assert not is_light_uneven([replace(alone, flags=frozenset({Flag.OCCLUDED}))])
    assert not is_light_uneven([])
