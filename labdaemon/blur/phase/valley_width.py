"""How wide a valley of the phase is where it is no parabola: shelves and second minima next to the best phase.

Under coded light a motion of one or two pixels may have a cost over its phase that is nearly level for a quarter of a
radian, with a steep wall at either end. The curvature at the minimum says nothing of that, and the truth lies ten of
its standard deviations away. So the cost is followed on either side, and each phase counts by its probability.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.phase_arc import PhaseTable, condition_on_phase, turned_motion
from labdaemon.blur.settings import PHASE
from labdaemon.blur.smear.frame_set import FRAME_PARAMETERS, FrameSet, window_fixed_phase_transfer
from labdaemon.blur.smear.texture_frames import correct_cost
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.half_turn import major_phase_rad


def widen_by_valley(
    frame_set: FrameSet, near: Solution, value: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, PhaseTable | None]:
    """The covariance with the scatter over all phases of the valley, where that is larger than the linear one.

    Parameters
    ----------
    frame_set
        The frames that were fitted.
    near
        The fit: its places, illumination and weights are where the phases around are begun.
    value, covariance
        (6,) and (6, 6) x, y, ax, ay, bx, by of it, and their linear covariance.

    Returns
    -------
    covariance, axis_scatter_px2, table
        (6, 6), as given where the phase is known well, and under constant light; (2, 2) the scatter of the semi-axis
        over the valley, for those who do not use the phase; the motions at all phases of the valley, where it is wider
        than the covariance was.
    """
    nothing = np.zeros((2, 2))
    if not any(window.is_coded for window in frame_set.windows):
        return covariance, nothing, None
    phasor = value[2:4] + 1j * value[4:]
    size2 = float(np.sum(np.abs(phasor) ** 2))
    by_phase = np.concatenate((-value[4:], value[2:4]))
    variance = float(by_phase @ covariance[2:, 2:] @ by_phase) / max(size2**2, 1e-12)
    if not LIGHT.valley_scan_sd_rad**2 < variance < PHASE.linear_phase_sd_rad**2:
        return covariance, nothing, None
    phase = major_phase_rad(value[2:4], value[4:])
    vector = np.real(phasor * np.exp(-1j * phase))
    offsets, costs, places = _scan(frame_set, near, phase, vector)
    fine = np.linspace(offsets[0], offsets[-1], PHASE.phase_count + 1)
    cost = CubicSpline(offsets, costs)(fine)
    moved = CubicSpline(offsets, places)(fine)
    excess = (cost - cost.min()) / max(near.chi2, LIGHT.min_noise_scale)
    probability = np.exp(-excess / 2)
    probability /= probability.sum()
    scatter = float(probability @ fine**2)
    if scatter <= variance:
        return covariance, nothing, None
    refined = np.array([turned_motion(value - moved[len(fine) // 2], float(turn)) for turn in fine])
    table = PhaseTable(phase + fine, excess, moved + refined, condition_on_phase(value, covariance), phase)
    weight = (1 - variance / scatter) * probability
    axes = np.cos(phase + fine)[:, None] * moved[:, 2:4] + np.sin(phase + fine)[:, None] * moved[:, 4:]
    middle = len(fine) // 2
    from_middle, away = axes - axes[middle], moved - moved[middle]
    return covariance + (weight * away.T) @ away, (weight * from_middle.T) @ from_middle, table


def _scan(
    frame_set: FrameSet, near: Solution, phase_rad: float, vector: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """In-phase motions about a phase: (n,) offsets, (n,) costs, and (n, 6) x, y, ax, ay, bx, by."""
    fixed, frames = _as_lit(frame_set, near).with_fixed_shape(), len(frame_set.problems)
    start = np.concatenate((near.p[: FRAME_PARAMETERS * frames], vector))
    kept = near.weight
    reach = 3.0 + 1.5 * float(np.hypot(*vector))

    def fit(offset: float, start: FloatArray) -> tuple[float, FloatArray]:
        transfer_factory = window_fixed_phase_transfer(phase_rad + offset)
        model = fixed.forward_model(transfer_factory, reach)
        found = solve(
            fixed.planes,
            lambda _: kept,
            model,
            start,
            fixed.prior(2),
            light=near.light,
            max_iterations=6,
            tolerance=0.2,
        )
        return correct_cost(fixed, found, transfer_factory).cost, found.p

    steps = np.arange(1, LIGHT.valley_scan_steps + 1) / LIGHT.valley_scan_steps * LIGHT.same_valley_rad
    middle = fit(0.0, start)
    found = [(0.0, *middle)]
    for side in (1.0, -1.0):
        p = middle[1]
        for step in side * steps:
            cost, p = fit(float(step), p)
            found.append((float(step), cost, p))
    found.sort(key=lambda one: one[0])
    rows = []
    for offset, _, p in found:
        place = p[: FRAME_PARAMETERS * frames].reshape(frames, FRAME_PARAMETERS)[:, :2].mean(axis=0)
        turned = phase_rad + offset
        rows.append(np.concatenate((place, p[-2:] * np.cos(turned), p[-2:] * np.sin(turned))))
    return np.array([one[0] for one in found]), np.array([one[1] for one in found]), np.array(rows)


def _as_lit(frame_set: FrameSet, near: Solution) -> FrameSet:
    """The frames with the ambient light that was fitted instead of the stated one."""
    if not frame_set.ambient_count:
        return frame_set
    correction = float(near.p[frame_set.first_motion - 1])
    windows = [
        window
        if window.light is None
        else replace(window, light=replace(window.light, ambient=max(window.light.ambient + correction, 0.0)))
        for window in frame_set.windows
    ]
    return replace(frame_set, windows=windows)
