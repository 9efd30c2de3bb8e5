"""Flags of a target that several cameras see: what one camera leaves open, another one may decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur import Measurement
from labdaemon.flags import Flag
from labdaemon.geometry import ObjectMotion
from labdaemon.processing.envelope import _flags

ONE = np.ones(2)
MOTION = ObjectMotion(np.zeros(3), np.ones(3), np.ones(3), np.eye(9))
CLEAR = Measurement("t", ONE, ONE, ONE, np.eye(6), True)
LOOSE = replace(CLEAR, flags=frozenset({Flag.AMBIGUOUS}), axes=replace(CLEAR, phased=False))


def test_a_camera_that_shows_the_phase_decides_for_one_that_hardly_does() -> None:
    assert _flags({"left": CLEAR, "right": LOOSE}, MOTION, cameras=2, sure=True) == set()


def test_cameras_that_hardly_show_the_phase_decide_nothing() -> None:
    assert _flags({"left": LOOSE, "right": LOOSE}, MOTION, cameras=2, sure=True) == {Flag.AMBIGUOUS}


def test_what_the_cameras_together_leave_open_stays_ambiguous() -> None:
    doubtful = replace(MOTION, flags=frozenset({Flag.AMBIGUOUS}))
    assert _flags({"left": CLEAR, "right": LOOSE}, doubtful, cameras=2, sure=True) == {Flag.AMBIGUOUS}
