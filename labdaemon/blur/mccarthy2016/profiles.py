"""Pixel intensity profiles: the second stage of the published method, from a smear's features to its two ends.

After McCarthy, Chandler and Palmeri (2016), "Pixel Intensity Profiles". Profiles run parallel to the smear. Along each,
darkness rises and falls where the dot's edge stood at the ends of the path: the beginnings of the rise and of the fall
lie on the outline of the dot at one end of its path, their ends on the outline at the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from labdaemon.blur.patch import ellipse
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import PROFILE


@dataclass(frozen=True, slots=True)
class ProfileFrame:
    """Where the profiles lie: a frame along the smear.

    Attributes
    ----------
    x_px, y_px
        Middle of the smear in the image.
    half_length_px, half_width_px
        How far it reaches along and across its path.
    angle_rad
        Direction of the path, from +x towards +y.
    """

    x_px: float
    y_px: float
    half_length_px: float
    half_width_px: float
    angle_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class PathEnds:
    """The dot's two outlines at the ends of its path.

    Attributes
    ----------
    first_px, second_px
        (2,) centres of the two fitted ellipses.
    covariance_px2
        (2, 2) of the vector from the first to the second, from profile to profile (jackknife).
    longer
        True for a path longer than the dot.
    """

    first_px: FloatArray
    second_px: FloatArray
    covariance_px2: FloatArray
    longer: bool

    @property
    def vector_px(self) -> FloatArray:
        """(2,) from the first end to the second: the whole path, twice the semi-amplitude."""
        return self.second_px - self.first_px

    @property
    def middle_px(self) -> FloatArray:
        """(2,) mean position."""
        return np.asarray((self.first_px + self.second_px) / 2.0)


def rapid_estimate(dark: FloatArray, near: tuple[float, float]) -> ProfileFrame | None:
    """First stage: a threshold near the paper's white, and an ellipse by least squares around what exceeds it.

    Parameters
    ----------
    dark
        (h, w) 0 on paper, 1 in ink.
    near
        (x, y) where the target is expected.

    Returns
    -------
    The smear's frame from the ellipse's axes; None where nothing is dark.
    """
    smooth = ndimage.gaussian_filter(dark, 1.0)
    peak = float(np.percentile(smooth, 99.5))
    noise = 1.4826 * float(np.median(np.abs(smooth - np.median(smooth))))
    best: tuple[float, ellipse.Ellipse] | None = None
    for part in PROFILE.thresholds:
        outline = _outline(smooth, max(part * peak, 5.0 * noise, 0.02), near)
        shape = None if outline is None else ellipse.fit_ellipse(outline)
        if outline is None or shape is None:
            continue
        scatter = float(np.sqrt(np.mean((shape.radii(outline) - 1.0) ** 2)))
        # Shadows on a label make the outline of a low threshold ragged; elsewhere the one nearest to white is kept.
        if best is None or scatter < 0.8 * best[0]:
            best = (scatter, shape)
        if scatter < PROFILE.outline_scatter:
            break
    if best is None:
        return None
    shape = best[1]
    return ProfileFrame(shape.x_px, shape.y_px, shape.semi_major_px, shape.semi_minor_px, shape.angle_rad)


def _outline(smooth: FloatArray, threshold: float, near: tuple[float, float]) -> FloatArray | None:
    """(n, 2) outline of the dark region that is most likely the target; None where nothing is dark."""
    labels, count = ndimage.label(smooth > threshold)
    if not count:
        return None
    sums = ndimage.sum_labels(smooth, labels, np.arange(1, count + 1))
    centres = np.array(ndimage.center_of_mass(smooth, labels, np.arange(1, count + 1)))[:, ::-1]
    away = np.hypot(*(centres - near).T)
    region = ndimage.binary_fill_holes(labels == 1 + int(np.argmax(sums / (1.0 + away / 10.0) ** 2)))
    y, x = np.nonzero(region & ~ndimage.binary_erosion(region))
    return np.stack([x, y], axis=1).astype(np.float64)


def find_ends(dark: FloatArray, profile_frame: ProfileFrame, count: int) -> PathEnds | None:
    """Second stage: features on parallel profiles, one ellipse through each of two groups.

    Parameters
    ----------
    dark
        (h, w) 0 on paper, 1 in ink.
    profile_frame
        Where the profiles lie.
    count
        Number of profiles.

    Returns
    -------
    The two ends; None where the profiles show no features that make two ellipses.
    """
    reach = profile_frame.half_length_px * 1.05 + 4.0
    along = np.arange(-reach, reach, PROFILE.step_px)
    across = profile_frame.half_width_px * 0.9 * np.linspace(-1.0, 1.0, count)
    axis = np.array([np.cos(profile_frame.angle_rad), np.sin(profile_frame.angle_rad)])
    side = np.array([-axis[1], axis[0]])
    origin = np.array([profile_frame.x_px, profile_frame.y_px])
    at = origin + along[None, :, None] * axis + across[:, None, None] * side
    rows = ndimage.map_coordinates(dark, [at[..., 1], at[..., 0]], order=1, mode="nearest")
    smooth, slope, curvature = (
        ndimage.gaussian_filter1d(rows, PROFILE.smoothing_px / PROFILE.step_px, axis=1, order=order)
        for order in (0, 1, 2)
    )
    middle = smooth[count // 2 - 1 : count // 2 + 2].mean(axis=0)
    longer = float(middle.max()) < PROFILE.core_darkness
    found = [(offset, _find_features(*row)) for offset, *row in zip(across, smooth, slope, curvature, strict=True)]
    kept = _select_consistent([(offset, np.array(places)) for offset, places in found if places is not None])
    if len(kept) < max(6, count // 3):
        return None
    groups: tuple[list[FloatArray], list[FloatArray]] = ([], [])
    for offset, places in kept:
        points = origin + along[0] * axis + (places[:, None] * PROFILE.step_px) * axis + offset * side
        groups[0].append(points[:2])
        groups[1].append(points[2:])
    return _fit_path_ends(groups, longer)


def _select_consistent(found: list[tuple[float, FloatArray]]) -> list[tuple[float, FloatArray]]:
    """Without the profiles whose features lie another path apart than most: a feature was mistaken there."""
    if not found:
        return []
    lengths = np.array([(places[2] - places[0], places[3] - places[1]) for _, places in found]) * PROFILE.step_px
    off = np.abs(lengths - np.median(lengths)).max(axis=1)
    limit = max(3.0 * 1.4826 * float(np.median(off)), 1.0)
    return [one for one, far in zip(found, off, strict=True) if far <= limit]


def _find_features(
    profile: FloatArray, slope: FloatArray, curvature: FloatArray
) -> tuple[float, float, float, float] | None:
    """Places (in samples) of the beginnings of rise and fall, then of the ends of rise and fall.

    The derivative has two peaks up, where the edge that arrives turned round, and two down, for the edge that leaves.
    The rise begins before the first peak up and ends after the last, where the profile bends most; the fall likewise.
    With a dark core both peaks up lie before it and both peaks down after it. Without one the path is longer than the
    dot there, the target leaves one end before it reaches the other, and each half has one peak of either kind.
    """
    if profile.max() <= 0.02:
        return None
    up, down = _strong_peaks(slope), _strong_peaks(-slope)
    if profile.max() >= PROFILE.core_darkness:
        core = int(np.argmax(profile))
        up, down = [k for k in up if k < core], [k for k in down if k > core]
    else:
        up, down = sorted({*up, *_peak_per_half(slope)}), sorted({*down, *_peak_per_half(-slope)})
    if not up or not down or not up[0] < down[-1]:
        return None
    return (
        _max_curvature(slope, curvature, up[0], -1),
        _max_curvature(-slope, -curvature, down[0], -1),
        _max_curvature(slope, -curvature, up[-1], 1),
        _max_curvature(-slope, curvature, down[-1], 1),
    )


def _strong_peaks(values: FloatArray) -> list[int]:
    """Peaks of at least 35 % of the highest."""
    return [k for k in _find_peaks(values) if values[k] >= 0.35 * float(values.max())]


def _peak_per_half(values: FloatArray) -> list[int]:
    """The highest peak in each half of a profile, if it has at least 15 % of the highest of all."""
    peaks, half = _find_peaks(values), len(values) // 2
    sides = ([k for k in peaks if k < half], [k for k in peaks if k >= half])
    best = [max(side, key=lambda k: values[k]) for side in sides if side]
    return [k for k in best if values[k] >= 0.15 * float(values.max())]


def _max_curvature(slope: FloatArray, curvature: FloatArray, peak: int, direction: int) -> float:
    """Where the profile bends most on one side of a peak of its slope, as far as the slope lasts."""
    k = best = peak
    while 1 < k < len(curvature) - 2 and slope[k] > 0.15 * slope[peak]:
        k += direction
        if curvature[k] > curvature[best]:
            best = k
    return _refine_extremum(curvature, best)


def _find_peaks(values: FloatArray) -> list[int]:
    inner = values[1:-1]
    return [int(k) for k in 1 + np.flatnonzero((inner > values[:-2]) & (inner >= values[2:]) & (inner > 0.0))]


def _refine_extremum(values: FloatArray, k: int) -> float:
    """Place of an extremum from a parabola through three samples."""
    before, here, after = values[k - 1], values[k], values[k + 1]
    curvature = before - 2.0 * here + after
    return k + float(0.5 * (before - after) / curvature) if curvature != 0.0 else float(k)


def _fit_path_ends(groups: tuple[list[FloatArray], list[FloatArray]], longer: bool) -> PathEnds | None:
    whole = [_fit_centre(group) for group in groups]
    if whole[0] is None or whole[1] is None:
        return None
    blocks = 6
    vectors = []
    for block in range(blocks):
        left = [_fit_centre([p for k, p in enumerate(group) if k % blocks != block]) for group in groups]
        if left[0] is not None and left[1] is not None:
            vectors.append(left[1] - left[0])
    covariance = np.full((2, 2), np.nan)
    if len(vectors) >= 4:
        spread = np.array(vectors) - np.mean(vectors, axis=0)
        covariance = spread.T @ spread * (len(vectors) - 1) / len(vectors)
    return PathEnds(whole[0], whole[1], covariance, longer)


def _fit_centre(group: list[FloatArray]) -> FloatArray | None:
    """Centre of the ellipse through a group's points, once more without the worst of them."""
    points = np.concatenate(group)
    shape = ellipse.fit_ellipse(points)
    if shape is None:
        return None
    off = np.abs(shape.radii(points) - 1.0)
    keep = off <= max(3.0 * 1.4826 * float(np.median(off)), 0.02)
    if not keep.all() and keep.sum() >= 0.6 * len(points):
        shape = ellipse.fit_ellipse(points[keep]) or shape
    return np.array([shape.x_px, shape.y_px])
