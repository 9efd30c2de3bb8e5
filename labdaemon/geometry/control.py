"""What a set of control targets must fulfil before it is believed: enough, distinct, spread, and in millimetres."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import ORIENTATION

_UNITS = {0.001: "metres", 0.01: "centimetres", 0.1: "decimetres", 1 / 25.4: "inches", 1000.0: "micrometres"}


def check_names(names: Sequence[str]) -> None:
    """Refuse a control target that occurs twice.

    Raises
    ------
    DataError
        A name is there more than once.
    """
    twice = sorted(name for name, times in Counter(names).items() if times > 1)
    if twice:
        raise DataError(f"control target {', '.join(twice)} is there more than once: each id may be used for one place")


def check_control(names: Sequence[str], image_px: FloatArray, object_mm: FloatArray) -> None:
    """Refuse control that cannot orient a camera.

    Parameters
    ----------
    names
        n names.
    image_px, object_mm
        (n, 2) and (n, 3).

    Raises
    ------
    DataError
        Fewer than four, a name twice, numbers missing, all in a line, or lengths that look like metres.
    """
    if not len(names) == len(image_px) == len(object_mm):
        raise DataError(f"{len(names)} names, {len(image_px)} pixels and {len(object_mm)} positions: one of each each")
    check_names(names)
    if len(names) < 4:
        found = f" ({', '.join(names)})" if names else ""
        raise DataError(f"{len(names)} surveyed control targets in view{found}; at least 4 are needed")
    if not (np.isfinite(image_px).all() and np.isfinite(object_mm).all()):
        raise DataError("a control target has no number for a pixel or a coordinate")
    _, spread, _ = np.linalg.svd(object_mm - object_mm.mean(axis=0))
    extent = float(np.ptp(object_mm, axis=0).max())
    if extent < ORIENTATION.min_extent_mm:
        raise DataError(
            f"the control targets in view span only {extent:.3g} mm: the survey looks as if given in metres; "
            "write it in millimetres"
        )
    if spread[1] < 0.02 * spread[0]:
        raise DataError(f"control targets {', '.join(names)} all lie in a line: add some off that line")


def check_volume(object_mm: FloatArray, sd_object_mm: FloatArray) -> None:
    """Refuse control in one plane, which leaves the depth of a three-dimensional job to extrapolation.

    Raises
    ------
    DataError
        The points' thickness is within 2 % of their extent or within their survey's uncertainty.
    """
    _, spread, _ = np.linalg.svd(object_mm - object_mm.mean(axis=0))
    noise = 3.0 * float(np.sqrt(np.sum(sd_object_mm**2)))
    if spread[2] < max(0.02 * spread[0], noise):
        thickness = spread[2] / np.sqrt(len(object_mm))
        raise DataError(
            f"the control targets in view all lie in a plane (rms distance from it {thickness:.2f} mm): "
            "three-dimensional measurement needs some in front of or behind it"
        )


def check_scale(camera: OrientedCamera, object_mm: FloatArray, side_px: FloatArray, side_mm: float) -> None:
    """Compare the scale that the survey gives with the one that the targets' own size gives.

    Parameters
    ----------
    camera
        The camera as oriented on the survey.
    object_mm
        (n, 3) surveyed centres.
    side_px, side_mm
        (n,) apparent size of each target and its true one. Foreshortening only makes it smaller, so the largest
        ratios count.

    Raises
    ------
    DataError
        They disagree by more than a factor of two; the message names the unit that would explain it.
    """
    depth = camera.to_camera_axes(object_mm)[:, 2]
    from_size = side_mm * np.mean(camera.lens.focal_px) / np.asarray(side_px, dtype=float)
    ratio = float(np.median(depth / from_size))
    if 0.5 < ratio < 2.0:
        return
    unit = next((name for factor, name in _UNITS.items() if 0.6 < ratio / factor < 1.6), None)
    guess = f"as if the survey were in {unit}" if unit else "the survey or the targets' size is wrong"
    raise DataError(
        f"the survey puts the control targets {ratio:.3g} times as far away as their size of {side_mm:g} mm does: "
        f"{guess}; both must be in millimetres"
    )
