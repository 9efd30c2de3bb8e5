"""Envelopes as objects: amplitudes, unknown members, tables."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdaemon.envelope import Envelope, TargetEnvelope
from labdaemon.flags import Flag

length = st.floats(-5.0, 5.0).filter(lambda value: value == 0 or abs(value) > 1e-3)


def row(a: tuple[float, ...], b: tuple[float, ...], **more: object) -> dict[str, object]:
    values = {f"{name}{axis}_mm": v for name, vec in (("a", a), ("b", b)) for axis, v in zip("xyz", vec, strict=True)}
    sds = {f"sd_{name}{axis}_mm": 0.01 for name in ("", "a", "b") for axis in "xyz"}
    return {"target": "T01", "x_mm": 1.0, "y_mm": 2.0, "z_mm": 3.0, "flags": [], **values, **sds, **more}


@given(st.tuples(length, length, length), st.tuples(length, length, length))
def test_amplitude_is_the_largest_distance_from_the_mean(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    one = TargetEnvelope.from_row(row(a, b))
    angle = np.linspace(0, 2 * np.pi, 3601)
    path = np.outer(np.sin(angle), a) + np.outer(np.cos(angle), b)
    assert one.amplitude_mm == pytest.approx(np.linalg.norm(path, axis=1).max(), abs=1e-4)
    assert one.sd_mm == pytest.approx(0.01, rel=1e-6)  # equal and independent components: the sd of one of them


def test_unmeasured_targets_have_no_amplitude_and_unknown_members_are_ignored() -> None:
    data = {
        "capture": "c1",
        "frequency_hz": 5.0,
        "a_member_of_tomorrow": 1,
        "targets": [
            row((3.0, 0.0, 0.0), (0.0, 0.0, 0.0), flags=["at_rest", "flag_of_tomorrow"], colour="red"),
            {"target": "T02", "ax_mm": None, "flags": ["not_found"]},
        ],
    }
    envelope = Envelope.from_event(data)
    assert envelope.frequency_hz == 5.0
    assert envelope["T01"].flags == {Flag.AT_REST}
    assert math.isnan(envelope["T02"].amplitude_mm)
    assert math.isnan(envelope["T02"].sd_mm)
    assert "2 targets, 0 without flags" in repr(envelope)
    table = envelope.to_array()
    assert table["amplitude_mm"][0] == pytest.approx(3.0)
    assert table["flags"].tolist() == ["at_rest", "not_found"]
    with pytest.raises(KeyError, match="T09"):
        envelope["T09"]
