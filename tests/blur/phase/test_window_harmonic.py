"""A third harmonic without a gauge, through known windows."""

import numpy as np
import pytest

from labdaemon.bench.dots import PX_PER_MM, DotBench
from labdaemon.bench.signed_error import signed_error
from labdaemon.blur import Defocus, ExposureWindow, TargetFrames, estimate_group_harmonic, measure_group
from labdaemon.blur.phase.window_harmonic import HarmonicEvidence, window_harmonic

STILL = Defocus(0.0, 0.02)
WINDOWS = [ExposureWindow(5.0, 1.1, opening) for opening in (0.0, np.pi / 2)]
SIZES_MM, PHASES, DIRECTION = (1.0, 1.5), (0.4, 1.9), 0.5
ALONG = np.array([np.cos(DIRECTION), -np.sin(DIRECTION)])


def test_targets_of_a_group_show_a_harmonic_together_and_lose_its_bias() -> None:
    bench, targets = DotBench(7, 0.004), []
    for paper, (size, phase) in enumerate(zip(SIZES_MM, PHASES, strict=True)):
        patches = [
            bench.blurred(size, paper, 5.5, phase + (one.phase_rad or 0.0), direction_rad=DIRECTION, third=0.05)
            for one in WINDOWS
        ]
        targets.append(TargetFrames(bench.sharp(size, paper), patches, WINDOWS, STILL))
    first = [measure_group(one.sharp, one.patches, WINDOWS, defocus=STILL) for one in targets]
    harmonic = estimate_group_harmonic(targets, first)
    assert harmonic is not None
    assert harmonic.mean[0] == pytest.approx(0.05, abs=0.005)
    one = targets[0]
    last = measure_group(one.sharp, one.patches, WINDOWS, defocus=STILL, harmonics=harmonic.of(one.sharp.name))
    true = SIZES_MM[0] * PX_PER_MM * np.concatenate((np.cos(PHASES[0]) * ALONG, np.sin(PHASES[0]) * ALONG))
    before, after = signed_error(first[0], true), signed_error(last, true)
    assert abs(before.amplitude_pull) > 4
    assert abs(after.amplitude_pull) < 3
    assert abs(after.phase_pull) < 3


def evidence(name: str, c: float, s: float) -> HarmonicEvidence:
    information = np.diag([0.002**-2, 0.02**-2])
    return HarmonicEvidence(name, information, information @ np.array([c, s]))


def test_noise_is_no_harmonic_and_a_quadrature_part_is_expected_to_be_of_the_size_of_the_other() -> None:
    assert window_harmonic([]) is None
    assert window_harmonic([evidence("A", 0.002, 0.02), evidence("B", -0.001, -0.03)]) is None
    assert window_harmonic([evidence("A", 0.0, 0.15), evidence("B", 0.0, 0.15)]) is None
    found = window_harmonic([evidence("A", 0.021, 0.05), evidence("B", 0.019, 0.05)])
    assert found is not None
    assert found.mean[0] == pytest.approx(0.02, abs=1e-3)
    assert 0.02 < found.mean[1] < 0.05
    own, other = found.of("A"), found.of("C")
    assert own.sd[1] < other.sd[1] < own.sds[1][1]
