from __future__ import annotations

import numpy as np
import pytest

from labdaemon.findings import PhaseReference, ResponseSeries, frequency_response


def _series(**changes: object) -> ResponseSeries:
    values: dict[str, object] = {
        "frequency_hz": np.array([1.0, 2.0]),
        "amplitude": np.ones((2, 3, 1), complex),
        "sd_real": np.ones((2, 3, 1)),
        "sd_imag": np.ones((2, 3, 1)),
        "table_mm": np.ones(2),
        "sd_table": np.zeros(2),
        "targets": ("A", "B", "C"),
    }
    return ResponseSeries(**{**values, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"sd_real": np.ones((2, 3))}, "sd_real"),
        ({"sd_imag": np.ones((2, 2, 1))}, "sd_imag"),
        ({"table_mm": np.ones(3)}, "table_mm"),
        ({"table_mm": np.zeros(2)}, "positive"),
        ({"frequency_hz": np.array([0.0, 1.0])}, "positive"),
        ({"targets": ("A",)}, "names"),
    ],
)
def test_shapes_are_checked(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        _series(**changes)


def test_parts_keep_their_names() -> None:
    series = _series(at_rest=np.array([[True, False, False], [False, False, True]]))
    part = series.with_targets(np.array([2, 0])).subset(np.array([1]))
    assert part.targets == ("C", "A")
    assert part.resting().tolist() == [[True, False]]
    assert part.steps == 1


def test_values_without_sd_are_not_valid() -> None:
    sd = np.ones((2, 3, 1))
    sd[0, 0] = np.nan
    sd[1, 1] = 0.0
    amplitude = np.ones((2, 3, 1), complex)
    amplitude[0, 2] = np.nan
    assert _series(sd_real=sd, amplitude=amplitude).valid().sum() == 3


def test_frequency_responses_have_an_exact_input() -> None:
    series = frequency_response(np.array([1.0, 2.0]), np.ones((2, 4)), sd=0.1)
    assert series.amplitude.shape == (2, 4, 1)
    assert series.phase is PhaseReference.TABLE
    assert not series.sd_table.any()
