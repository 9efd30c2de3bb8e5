"""A target's motion from its blurred patch: the fit that all others are variations of."""

from __future__ import annotations

import numpy as np

from labdaemon.blur import shapes
from labdaemon.blur.axes import moment_axes, moment_matrix, phased_axes, positive, principal
from labdaemon.blur.law import DisplacementLaw, nodes_transfer
from labdaemon.blur.model import Setting, blurred_model, prepare
from labdaemon.blur.motion import ExtraBlur, Measurement, Start, Window
from labdaemon.blur.pixels import ComplexArray, FloatArray, Patch
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.solve import Solution, render_light, solve, solve_light
from labdaemon.blur.weights import nuisance_prior, pixel_weights, variance_scale
from labdaemon.blur.windowed import solve_windowed, timing_covariance
from labdaemon.flags import Flag

DEFAULT_BLUR = ExtraBlur(0.0, 0.15)
REST_SIGMAS = 3.0
WHOLE = 0.005  # cycles from whole below which the window's phase does not show
POOR_CHI2 = 1.35


def measure(
    sharp: SharpTarget,
    patch: Patch,
    *,
    window: Window | None = None,
    extra_blur: ExtraBlur | None = None,
    start: Start | None = None,
    orbit: bool = True,
    law: DisplacementLaw | None = None,
    camera_shift_px: FloatArray | None = None,
) -> Measurement:
    """Measure a target's motion.

    Parameters
    ----------
    sharp
        The target at rest.
    patch
        Part of the blurred frame that holds the whole smear and some paper around it.
    window
        When the shutter was open; without it, or without its phase, whole cycles are assumed.
    extra_blur
        What the frame's control targets say of defocus; None lets it vary by 0.15 px².
    start
        Where the target is expected; None takes its place in the sharp frame.
    orbit
        False forces straight motion.
    law
        A declared course of the displacement instead of a sinusoid: a is then the vector that multiplies it, b is none.
    camera_shift_px
        (2,) shift of the frame against the sharp one, added to the start when that comes from the sharp frame.

    Returns
    -------
    Measurement
        Numbers are NaN where the target could not be measured; the flags say why.
    """
    if not sharp.usable:
        return nothing(sharp, {Flag.NOT_FOUND})
    expected = np.asarray(start.centre_px if start is not None else sharp.centre_px, dtype=np.float64)
    if start is None and camera_shift_px is not None:
        expected = expected + camera_shift_px
    setting = prepare(sharp, patch, expected)
    if setting is None:
        return nothing(sharp, _why_nothing(patch))
    blur = extra_blur if extra_blur is not None else DEFAULT_BLUR
    if law is not None:
        return _declared(sharp, setting, blur, law)
    if window is not None and window.phase_rad is not None and abs(window.cycles - round(window.cycles)) > WHOLE:
        return _known_window(sharp, setting, blur, window, orbit=orbit)
    return _whole_cycles(sharp, setting, blur, orbit=orbit, window=window)


def nothing(sharp: SharpTarget, flags: set[Flag]) -> Measurement:
    """A measurement without numbers."""
    nan = np.full(2, np.nan)
    return Measurement(sharp.name, nan, nan, nan, np.full((6, 6), np.nan), flags=frozenset(flags), chi2=float("nan"))


def _why_nothing(patch: Patch) -> set[Flag]:
    if patch.valid.size and np.count_nonzero(patch.valid) < 0.3 * patch.valid.size:
        return {Flag.SATURATED, Flag.NOT_FOUND}
    return {Flag.NOT_FOUND}


def _whole_cycles(
    sharp: SharpTarget, setting: Setting, blur: ExtraBlur, *, orbit: bool, window: Window | None
) -> Measurement:
    k = len(setting.by_shape)
    weights = pixel_weights(sharp, setting.planes)
    prior = nuisance_prior(sharp, blur, 3)

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        low, axes = np.linalg.eigh(moment_matrix(p[3 + k :]))
        if low[0] < -1.5:
            fixed = axes @ np.diag(np.maximum(low, -1.5)) @ axes.T
            p[3 + k :] = fixed[0, 0], fixed[0, 1], fixed[1, 1]
        p[2] = np.clip(p[2], -1.0, 50.0)
        return p

    model = blurred_model(setting, shapes.orbit)
    free: Solution | None = None
    for start in _starts(sharp, setting, blur, k):
        found = solve(setting.planes, weights, model, start, prior, bound=bound)
        if free is None or found.cost < free.cost:
            free = found
    assert free is not None
    scale = variance_scale(sharp, free)
    lam, major, _, cov = principal(free.p[3 + k :], free.covariance[3 + k :, 3 + k :] * scale)
    sd = np.sqrt(np.maximum(np.diag(cov), 0))
    rest = lam[0] < REST_SIGMAS * sd[0]
    curved = orbit and not rest and lam[1] > REST_SIGMAS * sd[1]
    if curved:
        a, b, covariance = _orbit_axes(free, k, scale)
        best = free
    else:
        start = np.concatenate((free.p[: 3 + k], np.sqrt(max(lam[0], 0.02)) * major))
        best = solve(
            setting.planes,
            weights,
            blurred_model(setting, shapes.straight),
            start,
            nuisance_prior(sharp, blur, 2),
            light=free.light,
        )
        scale = variance_scale(sharp, best)
        a, b, covariance = _straight_axes(best, k, scale, float(sd[1]))
    flags = reach_flags(sharp, best, a, b)
    if rest:
        flags.add(Flag.AT_REST)
    if window is not None and window.phase_rad is None and abs(window.cycles - round(window.cycles)) > 0.05:
        flags.add(Flag.PART_CYCLES)
    return Measurement(
        sharp.name,
        best.p[:2].copy(),
        a,
        b,
        covariance,
        flags=frozenset(flags),
        extra_blur_px2=float(best.p[2]),
        chi2=best.chi2,
    )


def reach_flags(sharp: SharpTarget, best: Solution, a: FloatArray, b: FloatArray) -> set[Flag]:
    """What the residuals and the smear's reach say."""
    flags = set()
    if best.chi2 > POOR_CHI2 and sharp.noise_known:
        flags.add(Flag.POOR_FIT)
    reach = float(np.hypot(np.hypot(*a), np.hypot(*b))) + max(sharp.form.half_size_px)
    if reach > sharp.paper_px:
        flags.add(Flag.PAPER_EDGE)
    return flags


def _declared(sharp: SharpTarget, setting: Setting, blur: ExtraBlur, law: DisplacementLaw) -> Measurement:
    """Fit the vector that multiplies a declared course; both of its signs are tried."""
    k = len(setting.by_shape)

    def motion(fx: FloatArray, fy: FloatArray, vector: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return nodes_transfer(fx, fy, vector, law.displacement[None], law.weight)

    spread = float(law.weight @ law.displacement**2)
    model, weights = blurred_model(setting, motion), pixel_weights(sharp, setting.planes)
    prior = nuisance_prior(sharp, blur, 2)
    solutions = []
    for start in _starts(sharp, setting, blur, k):
        values, vectors = np.linalg.eigh(moment_matrix(start[3 + k :]))
        vector = vectors[:, 1] * np.sqrt(max(values[1], 0.02) * 0.5 / spread)
        for sign in (1.0, -1.0):
            solutions.append(
                solve(setting.planes, weights, model, np.concatenate((start[: 3 + k], sign * vector)), prior)
            )
    best = min(solutions, key=lambda x: x.cost)
    mirrored = min((x.cost for x in solutions if float(x.p[-2:] @ best.p[-2:]) < 0), default=np.inf)
    pick = [0, 1, 3 + k, 4 + k]
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = best.covariance[np.ix_(pick, pick)] * variance_scale(sharp, best)
    signed = mirrored - best.cost > 9.0 * max(best.chi2, 1.0)
    a = best.p[-2:].copy()
    if not signed and not np.array_equal(positive(a), a):
        a = -a
        covariance[:2, 2:4] *= -1
        covariance[2:4, :2] *= -1
    flags = reach_flags(sharp, best, a, np.zeros(2))
    sd = float(np.sqrt(a @ covariance[2:4, 2:4] @ a)) / max(float(np.hypot(*a)), 1e-12)
    if float(np.hypot(*a)) < REST_SIGMAS * sd:
        flags.add(Flag.AT_REST)
    return Measurement(
        sharp.name, best.p[:2].copy(), a, np.zeros(2), covariance, signed, frozenset(flags), float(best.p[2]), best.chi2
    )


def _known_window(sharp: SharpTarget, setting: Setting, blur: ExtraBlur, window: Window, *, orbit: bool) -> Measurement:
    """One frame through a known window: the axes as over whole cycles, but without the bias of the part cycle.

    The phase of a single frame has a mirror image that fits as well, so it is not reported; see `measure_group`.
    """
    moment = setting.blob.moment_px2 if setting.blob is not None else np.eye(2)
    spread = 2 * (moment - sharp.form.moment_px2 - blur.mean_px2 * np.eye(2))
    best, _ = solve_windowed(sharp, [setting], [window], [blur], spread)
    covariance = best.covariance * variance_scale(sharp, best) + timing_covariance(best, [setting], [window])
    pick = [0, 1, *range(len(best.p) - 4, len(best.p))]
    value, cov = best.p[pick], covariance[np.ix_(pick, pick)]
    centre, a, b, cov = phased_axes(value, cov)
    flags = reach_flags(sharp, best, a, b)
    size = float(np.hypot(*a))
    sd_a = float(np.sqrt(a @ cov[2:4, 2:4] @ a)) / max(size, 1e-12)
    if size < REST_SIGMAS * sd_a:
        flags.add(Flag.AT_REST)
    sd_b = float(np.sqrt(max(np.trace(cov[4:, 4:]), 0)))
    if not orbit or float(np.hypot(*b)) < REST_SIGMAS * sd_b:
        b = np.zeros(2)
    return Measurement(sharp.name, centre, a, b, cov, False, frozenset(flags), float(best.p[2]), best.chi2)


def _starts(sharp: SharpTarget, setting: Setting, blur: ExtraBlur, k: int) -> list[FloatArray]:
    """Parameters to start from: the smear's own moments, or for a texture several, its cost being not convex.

    A texture's sharp frame may have been taken anywhere on its path, so each amplitude is tried from both ends too.
    """
    if setting.blob is not None:
        spread = 2 * (setting.blob.moment_px2 - sharp.form.moment_px2 - blur.mean_px2 * np.eye(2))
        values, vectors = np.linalg.eigh(spread)
        moment = vectors @ np.diag(np.maximum(values, 0.02)) @ vectors.T
        guess = [moment[0, 0], moment[0, 1], moment[1, 1]]
        return [np.concatenate((setting.start_px, [blur.mean_px2], np.zeros(k), guess))]
    starts = []
    for amplitude in (0.7, 2.5, 6.0):
        for angle in (0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4):
            a = amplitude * np.array([np.cos(angle), np.sin(angle)])
            guess = [a[0] ** 2 + 0.02, a[0] * a[1], a[1] ** 2 + 0.02]
            for side in (-1, 0, 1):
                place = setting.start_px + side * a
                starts.append(np.concatenate((place, [blur.mean_px2], np.zeros(k), guess)))
    model = blurred_model(setting, shapes.orbit)
    costs = []
    for start in starts:
        dark, _ = model(start)
        weight = pixel_weights(sharp, setting.planes)(np.maximum(setting.planes.values, 0))
        light = solve_light(setting.planes, weight, dark)
        costs.append(float(np.sum(weight * (setting.planes.values - render_light(setting.planes, light, dark)) ** 2)))
    return [starts[index] for index in np.argsort(costs)[:4]]


def _orbit_axes(free: Solution, k: int, scale: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    pick = [0, 1, 3 + k, 4 + k, 5 + k]
    value, cov = moment_axes(free.p[pick], free.covariance[np.ix_(pick, pick)] * scale)
    return value[2:4], value[4:6], cov


def _straight_axes(
    best: Solution, k: int, scale: float, sd_minor_px2: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    pick = [0, 1, 3 + k, 4 + k]
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = best.covariance[np.ix_(pick, pick)] * scale
    a = best.p[3 + k :]
    sign = 1.0 if np.array_equal(positive(a), a) else -1.0
    covariance[:2, 2:4] *= sign
    covariance[2:4, :2] *= sign
    a = positive(a)
    size = float(np.hypot(*a))
    across = np.array([-a[1], a[0]]) / max(size, 1e-12)
    # b² is known to ± its own sd, so that |b| itself may be as large as the root of that.
    covariance[4:, 4:] = sd_minor_px2 * np.outer(across, across)
    return a, np.zeros(2), covariance
