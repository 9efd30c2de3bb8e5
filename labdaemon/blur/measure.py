"""A target's motion from its blurred patch: the fit that all others are variations of."""

from __future__ import annotations

import numpy as np

from labdaemon.blur import shapes
from labdaemon.blur.axes import moment_matrix, positive, principal
from labdaemon.blur.model import Setting, blurred_model, prepare
from labdaemon.blur.motion import ExtraBlur, Measurement, Start, Window
from labdaemon.blur.pixels import FloatArray, Patch
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.solve import Solution, render_light, solve, solve_light
from labdaemon.blur.weights import nuisance_prior, pixel_weights, variance_scale
from labdaemon.flags import Flag

DEFAULT_BLUR = ExtraBlur(0.0, 0.15)
REST_SIGMAS = 3.0
POOR_CHI2 = 1.35


def measure(
    sharp: SharpTarget,
    patch: Patch,
    *,
    window: Window | None = None,
    extra_blur: ExtraBlur | None = None,
    start: Start | None = None,
    orbit: bool = True,
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
    flags = set()
    if rest:
        flags.add(Flag.AT_REST)
    if best.chi2 > POOR_CHI2 and sharp.noise_known:
        flags.add(Flag.POOR_FIT)
    reach = float(np.max(np.hypot(a, b)) + max(sharp.form.half_size_px)) if np.all(np.isfinite(a)) else 0.0
    if reach > sharp.paper_px:
        flags.add(Flag.PAPER_EDGE)
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
    cov = free.covariance[np.ix_(pick, pick)] * scale

    def axes(p: FloatArray) -> FloatArray:
        lam, vectors = np.linalg.eigh(moment_matrix(p[2:]))
        lam = np.maximum(lam, 1e-12)
        return np.concatenate(
            (p[:2], positive(vectors[:, 1]) * np.sqrt(lam[1]), positive(vectors[:, 0]) * np.sqrt(lam[0]))
        )

    centre = free.p[pick]
    value = axes(centre)
    jacobian = np.empty((6, 5))
    for column in range(5):
        step = np.zeros(5)
        step[column] = 1e-5 * max(1.0, abs(centre[column]))
        up, down = axes(centre + step), axes(centre - step)
        jacobian[:, column] = (up - down) / (2 * step[column])
    return value[2:4], value[4:6], jacobian @ cov @ jacobian.T


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
