"""The published method, whole: rapid estimate, pixel intensity profiles, iterative refinement.

McCarthy, Chandler and Palmeri (2016), "Monitoring 3D vibrations in structures using high-resolution blurred imagery",
section "Image-processing procedure". It is the baseline that `labdaemon.blur.measure` is held against, and is
implemented as printed, its faults included:

- Features of profiles lie outside a blurred edge, not on it. The second stage therefore reads too much: about 1 px of
  semi-amplitude on a target at rest, 0.6 to 0.75 px from 2 px on (rendered dots of 18 and 31 px, lens blur 0.8 px). A
  target whose reading does not exceed that of its own sharp image is flagged `at_rest`.
- Equation (2), a raised cosine, stands for the dwell of a sinusoid. As printed its support has unit width; it is read
  as U-shaped over the path's full length L. Its variance is (1/3 + 2/π²) A² = 0.536 A² where the true one is 0.5 A²,
  and it ends softly where the true one is largest. The refinement reads up to 10 % too little from 1 to 3 px, then up
  to 0.8 px too much.
- The paper assumes white paper all round. Labels end, and shadows lie on them: `label` confines the stages to the label
  (the sharp image F of equation (1) is the dot *and* its label), the rapid estimate takes the threshold that gives an
  ellipse, and a round outline, which has no direction, is profiled in several.
- Nothing is known of noise: the covariance given is the scatter from profile to profile, without any bias.

A rendered D80 frame of 40 dots of 8 mm that move by 0.3 to 12 mm gave a mean error of +0.15 mm, a standard deviation of
0.10 mm and 95 % within 0.30 mm; the paper reports −0.115, 0.158 and 0.38 mm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage, signal

from labdaemon.blur.mccarthy2016.label import label_darkness
from labdaemon.blur.mccarthy2016.profiles import PathEnds, ProfileFrame, find_ends, rapid_estimate
from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.pixels import Dot, FloatArray, Patch
from labdaemon.blur.settings import PROFILE
from labdaemon.flags import Flag
from labdaemon.half_turn import within_half_turn


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
    ink, radius = _estimate_contrast(sharp, dot), dot.semi_major_px
    still_at = np.array([dot.x_px, dot.y_px])
    edge_px = dot.paper_px + 1.0  # paper is known up to a sample before its edge
    still = label_darkness(sharp, ink, still_at, radius, min(edge_px, 2.0 * radius + 12.0))
    dark = label_darkness(blurred, ink, near + origin, radius, edge_px)
    sharp_dot = _SharpDot(still, still_at - np.asarray(sharp.origin_px), radius)
    rapid = rapid_estimate(dark, (float(near[0]), float(near[1])))
    laid = None if rapid is None else _lay_profiles(dark, sharp_dot, rapid, profiles)
    if laid is None:
        return _empty_measurement(dot)
    profile_frame, real, excess_sigmas = laid
    path, flags = real.vector_px, set[Flag]()
    if sharp_dot.length_px(profile_frame, profiles) > 2.0 * PROFILE.max_still_ratio * radius:
        flags.add(Flag.POOR_FIT)
    if refine:
        refined, settled = _refine(sharp_dot, profile_frame, real, profiles, threshold_px)
        if settled:
            path = refined
        else:
            flags.add(Flag.POOR_FIT)
        if np.hypot(*path) < threshold_px or excess_sigmas < PROFILE.rest_sigmas:
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


@dataclass(frozen=True, slots=True, eq=False)
class _SharpDot:
    """The sharp image of equation (1), F: the dot and its label.

    Attributes
    ----------
    dark
        (h, w) darkness.
    centre_px
        (2,) centre of the dot in it.
    radius_px
        Semi-major axis of the dot.
    """

    dark: FloatArray
    centre_px: FloatArray
    radius_px: float

    def simulate(self, profile_frame: ProfileFrame, path_px: FloatArray, profiles: int) -> PathEnds | None:
        """Profiles of the image that a motion would leave, laid as on the real one."""
        room = int(np.ceil(profile_frame.half_length_px * 1.3 + self.radius_px)) + 12
        image = np.pad(self.dark, room, mode="edge")
        length = float(np.hypot(*path_px))
        if length > 0:
            kernel = raised_cosine(length, float(np.arctan2(path_px[1], path_px[0])))
            image = signal.fftconvolve(image, kernel, mode="same")
        x, y = self.centre_px + room
        return find_ends(image, replace(profile_frame, x_px=float(x), y_px=float(y)), profiles)

    def length_px(self, profile_frame: ProfileFrame, profiles: int) -> float:
        """Path that the profiles read from the dot at rest ("approximately 1 pixel"); infinite without features."""
        ends = self.simulate(profile_frame, np.zeros(2), profiles)
        return np.inf if ends is None else float(np.hypot(*ends.vector_px))


def _lay_profiles(
    dark: FloatArray, sharp_dot: _SharpDot, rapid: ProfileFrame, profiles: int
) -> tuple[ProfileFrame, PathEnds, float] | None:
    """Lay the profiles along the path, where a round outline does not show its direction in several ways.

    Returns
    -------
    profile_frame, ends, excess_sigmas
        Where they lie, what they read, and by how many sd that is more than the sharp dot's own reading.
    """
    frames = [rapid]
    if rapid.half_width_px > PROFILE.round_ratio * rapid.half_length_px:
        half = (rapid.half_length_px + rapid.half_width_px) / 2.0
        first = _moment_direction(dark, sharp_dot, rapid)
        turns = np.pi * np.arange(PROFILE.directions) / PROFILE.directions
        frames = [
            replace(rapid, half_length_px=half, half_width_px=half, angle_rad=first + float(turn)) for turn in turns
        ]
    best: tuple[ProfileFrame, PathEnds, float] | None = None
    for frame in frames:
        aligned = _align(dark, frame, profiles)
        if aligned is None:
            continue
        excess = _excess_sigmas(aligned[1], sharp_dot.simulate(aligned[0], np.zeros(2), profiles))
        if best is None or excess > best[2]:
            best = (*aligned, excess)
    return best


def _align(dark: FloatArray, frame: ProfileFrame, profiles: int) -> tuple[ProfileFrame, PathEnds] | None:
    """Turn the profiles into the direction of the path that they read."""
    ends = find_ends(dark, frame, profiles)
    for _ in range(2):
        if ends is None:
            return None
        vector = ends.vector_px
        turn = within_half_turn(float(np.arctan2(vector[1], vector[0])) - frame.angle_rad)
        if not PROFILE.realign_rad < abs(turn) < PROFILE.max_realign_rad:
            break
        c, s = abs(np.cos(turn)), abs(np.sin(turn))
        turned = ProfileFrame(
            float(ends.middle_px[0]),
            float(ends.middle_px[1]),
            float(np.hypot(frame.half_length_px * c, frame.half_width_px * s)),
            float(np.hypot(frame.half_length_px * s, frame.half_width_px * c)),
            frame.angle_rad + turn,
        )
        again = find_ends(dark, turned, profiles)
        if again is None:
            break
        frame, ends = turned, again
    return None if ends is None else (frame, ends)


def _excess_sigmas(real: PathEnds, still: PathEnds | None) -> float:
    """By how many standard deviations a path is longer than the sharp dot's own reading."""
    length = float(np.hypot(*real.vector_px))
    if still is None or length <= 0:
        return 0.0
    along = real.vector_px / length
    variance = float(along @ (real.covariance_px2 + still.covariance_px2) @ along)
    excess = length - float(np.hypot(*still.vector_px))
    return excess / float(np.sqrt(variance)) if np.isfinite(variance) and variance > 0 else 0.0


def _moment_direction(dark: FloatArray, sharp_dot: _SharpDot, rapid: ProfileFrame) -> float:
    """Direction in which the blurred dot's second moment exceeds the sharp dot's most."""
    reach = sharp_dot.radius_px + 8.0
    blurred = _second_moment(dark, np.array([rapid.x_px, rapid.y_px]), reach)
    _, vectors = np.linalg.eigh(blurred - _second_moment(sharp_dot.dark, sharp_dot.centre_px, reach))
    return float(np.arctan2(vectors[1, 1], vectors[0, 1]))


def _second_moment(dark: FloatArray, centre_px: FloatArray, reach_px: float) -> FloatArray:
    """(2, 2) second central moment of the darkness within a distance, above that of the rim."""
    yy, xx = np.mgrid[0 : dark.shape[0], 0 : dark.shape[1]]
    distance = np.hypot(xx - centre_px[0], yy - centre_px[1])
    rim = (distance >= reach_px - 1.5) & (distance < reach_px + 1.0)
    level = float(np.median(dark[rim])) if rim.any() else 0.0
    weight = np.where(distance < reach_px, np.clip(dark - level, 0.0, None), 0.0)
    total = max(float(weight.sum()), 1e-12)
    dx, dy = xx - (weight * xx).sum() / total, yy - (weight * yy).sum() / total
    cross = float((weight * dx * dy).sum()) / total
    return np.array([[float((weight * dx**2).sum()) / total, cross], [cross, float((weight * dy**2).sum()) / total]])


def _refine(
    sharp_dot: _SharpDot, profile_frame: ProfileFrame, real: PathEnds, profiles: int, threshold_px: float
) -> tuple[FloatArray, bool]:
    """Third stage: adjust the kernel until the simulated image gives the same path."""
    path = real.vector_px
    best, best_gap = path, np.inf
    for turn in range(PROFILE.max_iterations):
        ends = sharp_dot.simulate(profile_frame, path, profiles)
        if ends is None:
            break
        gap = real.vector_px - ends.vector_px
        size = float(np.hypot(*gap))
        if size < best_gap:
            best, best_gap = path, size
        if size < threshold_px:
            return best, True
        # Features jump by a sample from one image to the next; smaller steps then keep from swinging about the answer.
        longer = path + gap * (1.0 if turn < PROFILE.max_iterations // 4 else 0.4)
        # A path that would turn round has shrunk through zero: the target rests. Nor can it be much longer than the
        # profiles say; where the simulated features were mistaken once, this keeps the next image in range.
        path = longer if longer @ real.vector_px > 0.0 else 0.3 * path
        path = path * min(1.0, (1.3 * np.hypot(*real.vector_px) + 2.0) / max(float(np.hypot(*path)), 1e-9))
        if np.hypot(*path) < threshold_px / 3.0:
            return np.zeros(2), True
    return best, best_gap < 10.0 * threshold_px


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
