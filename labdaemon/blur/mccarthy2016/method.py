"""The published method, whole: rapid estimate, pixel intensity profiles, iterative refinement.

McCarthy, Chandler and Palmeri (2016), "Monitoring 3D vibrations in structures using high-resolution blurred imagery",
section "Image-processing procedure". It is the baseline that `labdaemon.blur.measure` is held against, and is
implemented as printed, its faults included:

- Features of profiles lie next to a blurred edge, not on it. The second stage therefore reads too much: 1.3 px of
  semi-amplitude on a target at rest, 0.6 to 0.75 px from 2 px on (rendered dots of 18 and 31 px, lens blur 0.8 px).
- Equation (2), a raised cosine, stands for the dwell of a sinusoid. As printed its support has unit width; it is read
  as U-shaped over the path's full length L. Its variance is (1/3 + 2/π²) A² = 0.536 A² where the true one is 0.5 A²,
  and it ends softly where the true one is largest. On the same dots the refinement reads 2 to 10 % too little from 1 to
  3 px, then up to 0.8 px too much, and something between 0 and 0.6 px at rest.
- Nothing is known of noise: the covariance given is the scatter from profile to profile, without any bias.

A rendered D80 frame of 40 dots of 8 mm that move by 0.3 to 12 mm gave a mean error of +0.15 mm, a standard deviation of
0.10 mm and 95 % within 0.30 mm; the paper reports −0.115, 0.158 and 0.38 mm.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage, signal

from labdaemon.blur.mccarthy2016.profiles import PathEnds, ProfileFrame, find_ends, rapid_estimate
from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.locate import darkness_map, mask_pixels
from labdaemon.blur.patch.pixels import Dot, FloatArray, Patch
from labdaemon.blur.settings import PROFILE
from labdaemon.flags import Flag


def measure_mccarthy2016(
    sharp: Patch,
    dot: Dot,
    blurred: Patch,
    *,
    start_px: FloatArray | None = None,
    profiles: int = PROFILE.profiles,
    threshold_px: float = PROFILE.threshold_px,
    refine: bool = True,
) -> Measurement:
    """Measure a dot's motion by the published method.

    Parameters
    ----------
    sharp
        The dot in the sharp frame, with some paper around it.
    dot
        Where it is there.
    blurred
        Its smear, with paper all round.
    start_px
        (2,) where the smear's middle is expected, frame coordinates; the patch's middle if None.
    profiles
        Number of profiles; 20 in the paper.
    threshold_px
        The refinement ends when the path measured in the simulated image, as a vector, is this close to the real
        one's.
    refine
        False stops after the second stage.

    Returns
    -------
    `a_px` is half the path, its largest component positive, `b_px` zero. `covariance_px2` is the scatter between
    profiles. Flags: `not_found` without features, `at_rest` where the refinement ends at no motion, `poor_fit` where it
    does not settle within ten times the threshold; the second stage's result then stays.
    """
    origin = np.asarray(blurred.origin_px, dtype=np.float64)
    height, width = blurred.shape
    near = np.array([(width - 1) / 2.0, (height - 1) / 2.0]) if start_px is None else start_px - origin
    ink = _estimate_contrast(sharp, dot)
    sharp = _mask_beyond_label(sharp, dot.x_px, dot.y_px, min(dot.paper_px, 2.0 * dot.semi_major_px + 12.0))
    blurred = _mask_beyond_label(blurred, float(near[0] + origin[0]), float(near[1] + origin[1]), dot.paper_px)
    dark = darkness_map(blurred, ink)
    profile_frame = rapid_estimate(dark, (float(near[0]), float(near[1])))
    real = None if profile_frame is None else find_ends(dark, profile_frame, profiles)
    if profile_frame is None or real is None:
        return _empty_measurement(dot)
    path, flags = real.vector_px, set[Flag]()
    if refine:
        refined, settled = _refine(darkness_map(sharp, ink), sharp, dot, profile_frame, real, profiles, threshold_px)
        if settled:
            path = refined
        else:
            flags.add(Flag.POOR_FIT)
        if np.hypot(*path) < threshold_px:
            flags.add(Flag.AT_REST)
    semi = path / 2.0
    if semi[np.argmax(np.abs(semi))] < 0.0:
        semi = -semi
    return Measurement(
        target=dot.name,
        centre_px=real.middle_px + origin,
        a_px=semi,
        b_px=np.zeros(2),
        covariance_px2=_path_covariance(real),
        flags=frozenset(flags),
    )


def raised_cosine(length_px: float, angle_rad: float) -> FloatArray:
    """Equation (2) as a kernel: U-shaped over the path's full length, by the trapezium rule, turned, of unit sum.

    Parameters
    ----------
    length_px
        L, the whole path, twice the semi-amplitude.
    angle_rad
        Its direction, from +x towards +y.

    Returns
    -------
    (n, n); n is not even.
    """
    half = length_px / 2.0
    reach = int(np.ceil(half)) + 1
    if length_px < 1e-6:
        kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
        kernel[reach, reach] = 1.0
        return kernel
    centres = np.arange(-reach, reach + 1, dtype=np.float64)
    low, high = np.clip(centres - 0.5, -half, half), np.clip(centres + 0.5, -half, half)
    row = (
        (high - low)
        * ((1.0 - np.cos(2 * np.pi * low / length_px)) + (1.0 - np.cos(2 * np.pi * high / length_px)))
        / 2.0
    )
    flat = np.zeros((2 * reach + 1, 2 * reach + 1))
    flat[reach] = row
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    # Output (y, x) is read from where turning back by the angle leads.
    back = np.array([[c, -s], [s, c]])
    kernel = ndimage.affine_transform(flat, back, offset=reach - back @ np.array([reach, reach]), order=1)
    return np.asarray(kernel / kernel.sum())


def _refine(
    still: FloatArray,
    sharp: Patch,
    dot: Dot,
    profile_frame: ProfileFrame,
    real: PathEnds,
    profiles: int,
    threshold_px: float,
) -> tuple[FloatArray, bool]:
    """Third stage: adjust the kernel until the simulated image gives the same path."""
    x, y = dot.x_px - sharp.origin_px[0], dot.y_px - sharp.origin_px[1]
    room = int(np.ceil(profile_frame.half_length_px * 1.3 + dot.semi_major_px)) + 12
    isolated = np.pad(_isolate_dot(still, x, y, dot), room)
    middle = np.array([x + room, y + room])
    path = real.vector_px
    best, best_gap = path, np.inf
    for turn in range(PROFILE.max_iterations):
        kernel = raised_cosine(float(np.hypot(*path)), float(np.arctan2(path[1], path[0])))
        simulated = signal.fftconvolve(isolated, kernel, mode="same")
        simulated_frame = ProfileFrame(
            float(middle[0]),
            float(middle[1]),
            profile_frame.half_length_px,
            profile_frame.half_width_px,
            profile_frame.angle_rad,
        )
        ends = find_ends(simulated, simulated_frame, profiles)
        if ends is None:
            break
        gap = real.vector_px - ends.vector_px
        size = float(np.hypot(*gap))
        if size < best_gap:
            best, best_gap = path, size
        if size < threshold_px:
            return best, True
        # Features jump by a sample from one look to the next; smaller steps then keep from swinging about the answer.
        longer = path + gap * (1.0 if turn < PROFILE.max_iterations // 4 else 0.4)
        # A path that would turn round has shrunk through zero: the target rests. Nor can it be much longer than the
        # profiles say; where the simulated features were mistaken once, this keeps the next look sane.
        path = longer if longer @ real.vector_px > 0.0 else 0.3 * path
        path = path * min(1.0, (1.3 * np.hypot(*real.vector_px) + 2.0) / max(float(np.hypot(*path)), 1e-9))
        if np.hypot(*path) < threshold_px / 3.0:
            return np.zeros(2), True
    return best, best_gap < 10.0 * threshold_px


def _mask_beyond_label(patch: Patch, x_px: float, y_px: float, reach_px: float) -> Patch:
    """The patch without what lies further from a point than the white paper reaches."""
    yy, xx = np.mgrid[0 : patch.shape[0], 0 : patch.shape[1]]
    distance = np.hypot(xx + patch.origin_px[0] - x_px, yy + patch.origin_px[1] - y_px)
    return mask_pixels(patch, distance > reach_px - 1.0)


def _isolate_dot(still: FloatArray, x: float, y: float, dot: Dot) -> FloatArray:
    """The sharp dot without what else is in its patch, so that no neighbour's ink is smeared into its image."""
    yy, xx = np.mgrid[0 : still.shape[0], 0 : still.shape[1]]
    distance = np.hypot(xx - x, yy - y)
    return np.where(distance < dot.semi_major_px + 6.0, still, 0.0)


def _estimate_contrast(sharp: Patch, dot: Dot) -> dict[int, float]:
    """1 − ink/white of each channel, from the sharp dot."""
    yy, xx = np.mgrid[0 : sharp.shape[0], 0 : sharp.shape[1]]
    distance = np.hypot(xx + sharp.origin_px[0] - dot.x_px, yy + sharp.origin_px[1] - dot.y_px)
    inside = (distance < 0.6 * dot.semi_minor_px) & sharp.valid
    around = (distance > dot.semi_major_px + 3.0) & (distance < dot.semi_major_px * 1.8 + 6.0) & sharp.valid
    result: dict[int, float] = {}
    for channel in np.unique(sharp.channel):
        ink, paper = (sharp.values[mask & (sharp.channel == channel)] for mask in (inside, around))
        if ink.size and paper.size and np.median(paper) > 0.0:
            result[int(channel)] = float(np.clip(1.0 - np.median(ink) / np.median(paper), 0.05, 1.0))
    return result


def _path_covariance(real: PathEnds) -> FloatArray:
    """(6, 6): the scatter of the path between profiles, halved for the semi-amplitude; NaN for the minor axis."""
    covariance = np.full((6, 6), np.nan)
    quarter = real.covariance_px2 / 4.0
    covariance[:4, :4] = 0.0
    covariance[:2, :2] = covariance[2:4, 2:4] = quarter
    return covariance


def _empty_measurement(dot: Dot) -> Measurement:
    nan = np.full(2, np.nan)
    return Measurement(dot.name, nan, nan, nan, np.full((6, 6), np.nan), flags=frozenset({Flag.NOT_FOUND}))
