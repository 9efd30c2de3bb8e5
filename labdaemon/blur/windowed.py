"""Motion seen through known windows: one or several frames, a and b common, each frame's mean position its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from labdaemon.blur.law import nodes_transfer, window_nodes
from labdaemon.blur.model import Setting, blurred_model
from labdaemon.blur.mosaic import Planes
from labdaemon.blur.motion import ExtraBlur, Window
from labdaemon.blur.pixels import ComplexArray, FloatArray
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.solve import Model, Prior, Solution, light_level, render_light, solve, solve_light
from labdaemon.blur.weights import pixel_weights, shape_precision

SHORT_LIST = 5  # starts that are followed to their end
DIFFERENT = 16.0  # squared distance, in the best solution's own deviations, from which another is not the same one
FRAME = 3  # x, y, extra blur: the parameters of each frame, before the shape's and the motion's


def solve_windowed(
    sharp: SharpTarget, settings: list[Setting], windows: Sequence[Window], blurs: list[ExtraBlur], spread: FloatArray
) -> tuple[Solution, Solution | None]:
    """Best solution from starts all round the phase circle, and the best one that differs from it in phase."""
    k = settings[0].shapes
    count = len(settings)
    planes = stack([s.planes for s in settings])
    model = _group_model(settings, planes, windows, 3.0 + 1.3 * float(np.sqrt(max(np.max(np.abs(spread)), 0.1))))
    size = FRAME * count + k + 4
    precision, mean = np.zeros((size, size)), np.zeros(size)
    for index, blur in enumerate(blurs):
        precision[FRAME * index + 2, FRAME * index + 2] = 1 / max(blur.sd_px2, 1e-4) ** 2
        mean[FRAME * index + 2] = blur.mean_px2
    precision[FRAME * count : FRAME * count + k, FRAME * count : FRAME * count + k] = shape_precision(sharp)
    prior = Prior(mean, precision)
    weights = pixel_weights(sharp, planes)
    fixed = np.concatenate([*([*x.start_px, e.mean_px2] for x, e in zip(settings, blurs, strict=True)), np.zeros(k)])
    starts = [_begin(fixed, windows, a, b) for a, b in _round_the_circle(spread)]
    costs = [_rough_cost(planes, weights, model, start) for start in starts]
    promising = [starts[index] for index in np.argsort(costs)[:SHORT_LIST]]
    solutions = [solve(planes, weights, model, start, prior, max_iterations=25) for start in promising]
    best = min(solutions, key=lambda x: x.cost)
    # An orbit run through the other way round looks almost alike.
    mirrored = _begin(fixed, windows, *_other_way_round(best.p[-4:-2], best.p[-2:]))
    solutions.append(solve(planes, weights, model, mirrored, prior, max_iterations=25))
    solutions.sort(key=lambda x: x.cost)
    best = solutions[0]
    information = np.linalg.pinv(best.covariance[-4:, -4:], hermitian=True)
    away = [(x, x.p[-4:] - best.p[-4:]) for x in solutions[1:]]
    others = [x for x, d in away if float(d @ information @ d) > DIFFERENT]
    return best, others[0] if others else None


def _round_the_circle(spread: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Vectors a and b with the smear's second moment, at eight phases and, for an orbit, in both senses."""
    values, vectors = np.linalg.eigh(spread)
    major = np.sqrt(max(values[1], 0.05)) * vectors[:, 1]
    minor = 0.7 * np.sqrt(max(values[0], 0.02)) * vectors[:, 0]
    pairs = []
    for psi in np.arange(8) * np.pi / 4:
        for turn in (1.0, -1.0) if values[0] > 0.02 * values[1] else (1.0,):
            c, s = np.cos(psi), np.sin(psi)
            pairs.append((major * c - turn * minor * s, major * s + turn * minor * c))
    return pairs


def _other_way_round(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same ellipse and the same phase along its major axis, run through in the other sense."""
    _, vectors = np.linalg.eigh(np.outer(a, a) + np.outer(b, b))
    mirror = np.eye(2) - 2 * np.outer(vectors[:, 0], vectors[:, 0])
    return mirror @ a, mirror @ b


def _begin(fixed: FloatArray, windows: Sequence[Window], a: FloatArray, b: FloatArray) -> FloatArray:
    """Parameters to start from; the smear's middle is the mean place plus what the window adds to it."""
    start = np.concatenate((fixed, a, b))
    for index, window in enumerate(windows):
        basis, weight = window_nodes(window, 3.0)
        start[FRAME * index : FRAME * index + 2] -= a * (basis[0] @ weight) + b * (basis[1] @ weight)
    return start


def _rough_cost(planes: Planes, weights: Callable[[FloatArray], FloatArray], model: Model, start: FloatArray) -> float:
    dark, _ = model(start)
    weight = weights(np.maximum(planes.values, 0))
    light = solve_light(planes, weight, dark)
    return float(np.sum(weight * (planes.values - render_light(planes, light, dark)) ** 2))


def stack(parts: list[Planes]) -> Planes:
    """Patches of several frames as one, each lattice keeping its own place; smaller ones are padded with nothing."""
    height = max(p.values.shape[1] for p in parts)
    width = max(p.values.shape[2] for p in parts)
    values, valid, offsets = [], [], []
    origin = parts[0].origin_px
    for p in parts:
        pad = ((0, 0), (0, height - p.values.shape[1]), (0, width - p.values.shape[2]))
        values.append(np.pad(p.values, pad))
        valid.append(np.pad(p.valid, pad))
        offsets.append(p.offset_px + (np.asarray(p.origin_px) - np.asarray(origin)))
    channel = np.concatenate([p.channel for p in parts])
    return Planes(
        np.concatenate(values), np.concatenate(valid), channel, np.concatenate(offsets), parts[0].period, origin
    )


def _group_model(settings: list[Setting], planes: Planes, windows: Sequence[Window], reach_px: float) -> Model:
    count = len(settings)
    lattices = len(settings[0].planes.channel)
    models = []
    for setting, window in zip(settings, windows, strict=True):
        basis, weight = window_nodes(window, reach_px)
        models.append(blurred_model(setting, partial(_at_nodes, basis=basis, weight=weight)))

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        dark = np.zeros(planes.values.shape)
        by_p = np.zeros((len(p), *planes.values.shape))
        for index, (one, setting) in enumerate(zip(models, settings, strict=True)):
            own = np.concatenate((p[FRAME * index : FRAME * index + FRAME], p[FRAME * count :]))
            image, slopes = one(own)
            rows = slice(lattices * index, lattices * (index + 1))
            _, height, width = setting.planes.values.shape
            dark[rows, :height, :width] = image
            by_p[FRAME * index : FRAME * index + FRAME, rows, :height, :width] = slopes[:FRAME]
            by_p[FRAME * count :, rows, :height, :width] = slopes[FRAME:]
        return dark, by_p

    return model


def _at_nodes(
    fx: FloatArray, fy: FloatArray, vectors: FloatArray, *, basis: FloatArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    return nodes_transfer(fx, fy, vectors, basis, weight)


def timing_covariance(best: Solution, settings: list[Setting], windows: Sequence[Window]) -> FloatArray:
    """Covariance that the windows' phase and length uncertainties add, by finite differences of the model."""
    planes = stack([s.planes for s in settings])
    size = len(best.p)
    total = np.zeros((size, size))
    reach = 3.0 + 1.3 * float(np.linalg.norm(best.p[-4:]))
    base, _ = _group_model(settings, planes, windows, reach)(best.p)
    level = light_level(planes, best.light) * best.light[:, 3, None, None]
    for index, window in enumerate(windows):
        for kind, sd in (("phase", window.sd_phase_rad), ("exposure", window.sd_exposure_s)):
            if sd <= 0:
                continue
            phase = window.phase_rad or 0.0
            other = (
                Window(window.frequency_hz, window.exposure_s, phase + sd)
                if kind == "phase"
                else Window(window.frequency_hz, window.exposure_s + sd, phase)
            )
            changed = [*windows]
            changed[index] = other
            moved, _ = _group_model(settings, planes, changed, reach)(best.p)
            change = -level * (moved - base)
            shift = np.einsum("knhw,nhw->k", best.gain, change)
            total += np.outer(shift, shift)
    return total
