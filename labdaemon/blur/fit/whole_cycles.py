"""A sinusoid over whole cycles, phase unknown: the everyday case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from labdaemon.blur.axes import moment_axes, moment_matrix, positive, principal
from labdaemon.blur.motion import ExtraBlur, Measurement, nothing
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.sharp.target import Ellipse, SharpTarget
from labdaemon.blur.sharp.weights import noise_scale, nuisance_prior, pixel_weights
from labdaemon.blur.smear.gls import weigh_grain
from labdaemon.blur.smear.honesty import POOR_CHI2, REST_SIGMAS, honest_covariance, reach_flags, sight_flags
from labdaemon.blur.smear.model import Setting, blurred_model, prepare
from labdaemon.blur.smear.starts import starts_of
from labdaemon.blur.smear.template import without_template_noise
from labdaemon.blur.solver.normal import Prior, Solution
from labdaemon.blur.solver.solve import SHORT, approach, one_step, restricted, solve
from labdaemon.blur.spectra import shapes
from labdaemon.flags import Flag

LEAST_PX2 = 0.05  # a straight path's a² to start from: at rest the picture does not depend on a
HELD_PX2 = 1e-4  # the same where a is not fitted at all
QUICK_PX = 1.2  # semi-amplitude from which a smear's own moments are a start good enough for a straight fit
# Steps of an approach that may be its last: a moment is nearly linear, a path's end less so.
LAST_OF_PATH = np.array([0.2, 0.2, 0.2, 0.2, 0.2])
LAST_OF_ORBIT = np.array([0.2, 0.2, 0.2, 1.0, 1.0, 1.0])
BLUR_PX2 = (-1.0, 50.0)  # extra blur that a frame can have
FAN = np.linspace(-1.0, 1.0, 91)


def measure_whole_cycles(
    sharp: SharpTarget, patch: Patch, setting: Setting, blur: ExtraBlur, *, orbit: bool, flags: set[Flag]
) -> Measurement:
    """Fit an orbit by its second moment; then a straight path, where the minor axis does not show.

    Parameters
    ----------
    sharp, patch, setting, blur
        The target, the blurred patch, what `prepare` made of them, and the frame's defocus.
    orbit
        False forces straight motion.
    flags
        Flags to start with.
    """
    k = setting.shapes
    starts = starts_of(sharp, setting, blur, k)
    thin = False
    quick = _quick_orbit(sharp, setting, blur, starts[0]) if _is_plain(sharp) else None
    if quick is not None:
        free, thin = quick
    else:
        free = _fit_orbit(sharp, setting, blur, starts)
    for _ in range(2):
        if not _mask_depends_on_motion(sharp):
            break
        axes, _ = moment_axes(_picked(free, k), np.eye(5))
        again = prepare(sharp, patch, setting.start_px, known=(axes[:2], axes[2:4], axes[4:]))
        if again is None:
            break
        setting = again
        free = _fit_orbit(sharp, setting, blur, [free.p])
    if free.dof <= 0:  # all is masked, or is bright enough to have been at white level
        return nothing(sharp.name, flags | {Flag.NOT_FOUND})
    scale = noise_scale(sharp, free)
    spread = honest_covariance(sharp, free, setting.planes)
    lam, _, _, cov = principal(free.p[3 + k :], spread[3 + k :, 3 + k :])
    sd = np.sqrt(np.maximum(np.diag(cov), 0))
    # A round orbit and a defocus look alike: without controls, what one loses must not become the other.
    minor = lam[1] + (2 * (free.p[2] - blur.mean_px2) if blur.one_sided_px2 > 0 else 0.0)
    if orbit and lam[0] > REST_SIGMAS * sd[0] and minor > REST_SIGMAS * np.hypot(sd[1], blur.one_sided_px2):
        free = weigh_grain(
            sharp,
            setting,
            free,
            blurred_model(setting, shapes.orbit, exact=True),
            free.p[3 + k :],
            nuisance_prior(sharp, blur, 3),
        )
        spread = honest_covariance(sharp, free, setting.planes)
        value, covariance = moment_axes(_picked(free, k), spread[np.ix_(_pick(k), _pick(k))])
        best, a, b = free, value[2:4], value[4:]
    else:
        # Where a² is seen and b² is not, a step from the orbit's straight neighbour leaves a hundredth of a deviation.
        narrow = sharp.noise_known and free.converged and abs(lam[1]) < REST_SIGMAS * sd[1]
        clear = narrow and lam[0] > REST_SIGMAS * sd[0]
        rest = _is_plain(sharp) and not thin and free.converged and lam[0] < REST_SIGMAS * sd[0]
        best = _fit_straight(sharp, setting, blur, free, scale, converged=thin or clear, held=rest)
        spread = honest_covariance(sharp, best, setting.planes)
        a, b, covariance = _straight_axes(best.p, spread, k, float(sd[1]))
    found_flags = reach_flags(sharp, best, a, b)
    if Flag.PART_CYCLES in flags and Flag.POOR_FIT not in sharp.flags:
        found_flags.discard(Flag.POOR_FIT)  # the part cycle explains what is left over
    flags = flags | found_flags
    size = float(np.hypot(*a))
    along = a / max(size, 1e-12)
    sd_along = float(np.sqrt(along @ covariance[2:4, 2:4] @ along))
    flags |= sight_flags(setting.planes, min(sd_along, np.sqrt(sd[0])), size)
    # The amplitude shows by its square: it is seen when that exceeds three of its own deviations.
    sd_square = 2 * size * sd_along
    rest = lam[0] < REST_SIGMAS * sd[0]
    limit = float(np.hypot(sd_square, max(blur.one_sided_px2, 0.0)))
    if rest or size**2 < REST_SIGMAS * limit:
        flags.add(Flag.AT_REST)
        covariance = _resting(covariance, size, max(limit, float(sd[0]) if rest else 0.0))
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


def _is_plain(sharp: SharpTarget) -> bool:
    """A dot with reliable noise and nothing but grain on its paper: no fit of it needs more than one start."""
    return sharp.noise_known and isinstance(sharp.form, Ellipse) and sharp.form.relief is None


def _quick_orbit(
    sharp: SharpTarget, setting: Setting, blur: ExtraBlur, start: FloatArray
) -> tuple[Solution, bool] | None:
    """The orbit's fit by way of one with the target's shape held: one step frees the shape. None where that fails.

    The second value tells that the path is long and straight, and was fitted as such.
    """
    k = setting.shapes
    prior = nuisance_prior(sharp, blur, 3)
    weights = pixel_weights(sharp, setting.planes)
    model = blurred_model(setting, shapes.orbit)
    rigid = replace(setting, target=setting.target.rigid)
    keep = [0, 1, 2, *range(3 + k, 6 + k)]
    held = Prior(prior.mean[keep], prior.precision[np.ix_(keep, keep)])

    def free_shape(at: FloatArray, moment: FloatArray, light: FloatArray) -> Solution | None:
        begin = np.concatenate((at[:3], np.zeros(k), moment))
        free = one_step(setting.planes, weights, model, begin, prior, light)
        kept = free.chi2 < POOR_CHI2 and float(np.max(np.abs(free.p[3 : 3 + k]))) < SHORT
        return free if kept else None

    values, vectors = np.linalg.eigh(moment_matrix(start[3 + k :]))
    if values[1] - values[0] >= QUICK_PX**2 and values[0] <= 0.1 * values[1] + 4.0:
        begin = np.concatenate((start[:3], np.sqrt(values[1]) * vectors[:, 1]))
        path = approach(
            setting.planes,
            weights,
            blurred_model(rigid, shapes.straight),
            begin,
            Prior(held.mean[:5], held.precision[:5, :5]),
            LAST_OF_PATH,
            bound=_bound_blur,
        )
        if path is not None and float(np.hypot(*path[0][3:])) >= QUICK_PX:
            ax, ay = path[0][3:]
            free = free_shape(path[0], np.array([ax**2, ax * ay, ay**2]), path[1])
            if free is not None:
                lam, _, _, cov = principal(free.p[3 + k :], free.covariance[3 + k :, 3 + k :])
                if lam[1] <= 2.0 * float(np.sqrt(cov[1, 1])):
                    return free, True
    begin = np.concatenate((start[:3], start[3 + k :]))
    curve = approach(
        setting.planes, weights, blurred_model(rigid, shapes.orbit), begin, held, LAST_OF_ORBIT, bound=_bound(0)
    )
    free = free_shape(curve[0], curve[0][3:], curve[1]) if curve is not None else None
    return None if free is None else (free, False)


def _mask_depends_on_motion(sharp: SharpTarget) -> bool:
    form = sharp.form
    return isinstance(form, Ellipse) and form.relief is not None and form.relief.bounded


def _bound(k: int) -> Callable[[FloatArray], FloatArray]:
    """Keeps an orbit's parameters where its model is defined."""

    def bound(p: FloatArray) -> FloatArray:
        p = p.copy()
        low, axes = np.linalg.eigh(moment_matrix(p[3 + k :]))
        if low[0] < -1.5:
            fixed = axes @ np.diag(np.maximum(low, -1.5)) @ axes.T
            p[3 + k :] = fixed[0, 0], fixed[0, 1], fixed[1, 1]
        return _bound_blur(p)

    return bound


def _bound_blur(p: FloatArray) -> FloatArray:
    """Keeps the extra blur where a frame can have it."""
    p = p.copy()
    p[2] = np.clip(p[2], *BLUR_PX2)
    return p


def _fit_orbit(sharp: SharpTarget, setting: Setting, blur: ExtraBlur, starts: list[FloatArray]) -> Solution:
    model = blurred_model(setting, shapes.orbit)
    prior = nuisance_prior(sharp, blur, 3)
    bound = _bound(setting.shapes)
    best: Solution | None = None
    for start in starts:
        found = solve(setting.planes, pixel_weights(sharp, setting.planes), model, start, prior, bound=bound)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    if not sharp.noise_known:
        # The prior must be weighed against the noise as it is found.
        weights = pixel_weights(sharp, setting.planes, noise_scale(sharp, best))
        best = solve(setting.planes, weights, model, best.p, prior, bound=bound, light=best.light)
    return without_template_noise(sharp, setting, best, shapes.orbit)


def _fit_straight(
    sharp: SharpTarget,
    setting: Setting,
    blur: ExtraBlur,
    free: Solution,
    scale: float,
    *,
    converged: bool,
    held: bool,
) -> Solution:
    """The straight path: next to the orbit where `converged`; with a as the orbit says where `held`: it does not show.

    There, where grain is to be weighed, its own step is the only look at the picture.
    """
    k = setting.shapes
    prior = nuisance_prior(sharp, blur, 2)
    start, step = _straight_neighbour(free, k, HELD_PX2 if held else LEAST_PX2)
    if held:
        precision = prior.precision.copy()
        precision[3 + k :, 3 + k :] = np.eye(2) / HELD_PX2**2
        prior = Prior(np.concatenate((prior.mean[: 3 + k], start[3 + k :])), precision)
    if held or converged:
        best = restricted(free, nuisance_prior(sharp, blur, 3), start, step, _by_path(start[3 + k :], k), prior)
    else:
        weights, model = pixel_weights(sharp, setting.planes, scale), blurred_model(setting, shapes.straight)
        light = free.light - free.light_part @ step
        best = solve(setting.planes, weights, model, start, prior, bound=_bound_blur, light=light)
    exact = blurred_model(setting, shapes.straight, exact=True)
    ax, ay = best.p[3 + k :]
    best = weigh_grain(sharp, setting, best, exact, np.array([ax**2, ax * ay, ay**2]), prior)
    return without_template_noise(sharp, setting, best, shapes.straight)


def _by_path(a: FloatArray, k: int) -> FloatArray:
    """(6 + k, 5 + k) derivatives of an orbit's parameters by those of a straight path."""
    result = np.zeros((6 + k, 5 + k))
    result[: 3 + k, : 3 + k] = np.eye(3 + k)
    result[3 + k :, 3 + k :] = [[2 * a[0], 0.0], [a[1], a[0]], [0.0, 2 * a[1]]]
    return result


def _straight_neighbour(free: Solution, k: int, least_px2: float) -> tuple[FloatArray, FloatArray]:
    """Straight path (x, y, extra variance, shape…, ax, ay) that an orbit's fit makes most likely, and the step to it.

    The cost is nearly quadratic in the second moment M, so that the best M = aaᵀ is found without the picture.
    """
    moment = free.p[3 + k :]
    precision = np.linalg.inv(free.covariance[3 + k :, 3 + k :])
    _, vectors = np.linalg.eigh(moment_matrix(moment))
    middle, width = float(np.arctan2(vectors[1, 1], vectors[0, 1])), np.pi / 2
    for _ in range(2):
        angle = middle + width * FAN
        c, s = np.cos(angle), np.sin(angle)
        rays = np.stack((c * c, c * s, s * s), axis=1)
        along = rays @ precision
        square = np.maximum(along @ moment / np.maximum(np.einsum("ij,ij->i", along, rays), 1e-300), least_px2)
        away = square[:, None] * rays - moment
        best = int(np.argmin(np.einsum("ij,ij->i", away @ precision, away)))
        middle, width = float(angle[best]), width / 40
    step = free.covariance[:, 3 + k :] @ precision @ away[best]
    a = np.sqrt(square[best]) * np.array([np.cos(middle), np.sin(middle)])
    return np.concatenate(((free.p + step)[: 3 + k], a)), step


def _pick(k: int) -> list[int]:
    return [0, 1, 3 + k, 4 + k, 5 + k]


def _picked(free: Solution, k: int) -> FloatArray:
    result: FloatArray = free.p[_pick(k)]
    return result


def _straight_axes(
    p: FloatArray, spread: FloatArray, k: int, sd_minor_px2: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    pick = [0, 1, 3 + k, 4 + k]
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = spread[np.ix_(pick, pick)]
    a = p[3 + k :]
    if not np.array_equal(positive(a), a):
        covariance[:2, 2:4] *= -1
        covariance[2:4, :2] *= -1
        a = -a
    across = np.array([-a[1], a[0]]) / max(float(np.hypot(*a)), 1e-12)
    # b² is known to ± its own deviation, so |b| may be as large as the root of that.
    covariance[4:, 4:] = sd_minor_px2 * np.outer(across, across)
    return a, np.zeros(2), covariance


def _resting(covariance: FloatArray, size: float, sd_square: float) -> FloatArray:
    """Covariance with that of a replaced: near rest only a² is known, and its direction is not."""
    result = covariance.copy()
    sd = np.sqrt(size**2 + sd_square) - size
    result[2:4, :] = result[:, 2:4] = 0.0
    result[2:4, 2:4] = sd**2 * np.eye(2)
    return result
