"""Which captures know a motion best in a given time: exposure, cycles, opening phases and light code.

For each excitation of a campaign the captures that a phase may ask for are planned as a campaign would plan them, and
the Cramér–Rao bound of amplitude and phase is predicted from the modelled images, with photon noise, read noise and
paper texture (`labdaemon.blur.predict_sd`). Codes have phases with neighbours that are hard to tell from them, and
small motions hardly show theirs: what that adds is predicted by the whole likelihood (`predict_scatter`). Repeated
captures lower the variance as 1/n, so that captures are compared by sd·√(time to take them). The bound is averaged over
all phases of the motion (root mean square) and over the expected amplitudes (geometric mean).

What one opening shows depends on its phase against the motion alone: openings of all groups share their information.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from labdaemon.blur import (
    ExposureWindow,
    FloatArray,
    LightCode,
    light_fraction,
    motion_information,
    motion_vectors,
    predict_scatter,
    sd_of_information,
)
from labdaemon.campaign.campaign_file import Campaign, CampaignSection, DwellPhase, StepsPhase, SweepPhase
from labdaemon.campaign.capture_design import CaptureDesign, Expectation, Goal, GroupPrecision, StepDesign
from labdaemon.campaign.plan import PlanRig, make_plan
from labdaemon.campaign.steps import Step
from labdaemon.capture.exposure import common_steps_s
from labdaemon.errors import LabdaemonError

ExcitedPhase = StepsPhase | SweepPhase | DwellPhase

OPENINGS: tuple[tuple[float, ...], ...] = (
    (0.0, math.pi / 2),
    (0.0, 2 * math.pi / 3),
    (0.0, 2 * math.pi / 3, 4 * math.pi / 3),
    (0.0, math.pi / 2, math.pi, 3 * math.pi / 2),
)
"""Groups of opening phases that are tried; one opening alone leaves the sign of the motion open."""
CODES: tuple[str | tuple[str, ...], ...] = ("1110100", ("cos", "sin"))
"""Light codes that are tried where the rig has a lamp."""
MOTION_PHASES = tuple((k + 0.5) * math.pi / 12 for k in range(12))
"""Phases of the motion over which the bound is averaged, over half a turn: a motion and its opposite are one case."""
CODED_MOTION_PHASES = tuple((k + 0.5) * math.pi / 24 for k in range(24))
"""The same under a light code, of which the bound has narrow peaks."""
LEAST_WHITE = 0.2
"""Paper darker than this part of what the campaign's own exposure gives is not tried."""
MOST_WHITE = 1.25
"""Paper brighter than this reaches the sensor's ceiling, where the campaign's own exposure gives 70 % of it."""
FIT_OVER_BOUND = 1.15
"""What the fits reach over the bound: 1.0 to 1.3 (`labdaemon bench planned`)."""
SCATTER_PHASES = 96
"""Phases of the motion over which the scatter beyond the bound is averaged."""
CURVED_RAD = 0.1
"""Bound of a phase under constant light from which other phases count as well: its likelihood is no parabola."""
LIMIT_CYCLES = 0.05
"""Without a known phase an exposure further from whole cycles is flagged `part_cycles`, and is not tried."""


class DesignSearch:
    """Looks for the best captures of excitations.

    Parameters
    ----------
    rig
        What the rig can do.
    expectation
        What is expected.
    goal
        What is to be known best.
    """

    def __init__(self, rig: PlanRig, expectation: Expectation, goal: Goal) -> None:
        # Room on disk is the campaign's business, and a prediction must not fill the plan's notes.
        self._rig = replace(rig, free_bytes=None)
        self._expectation, self._goal = expectation, goal
        self._known: dict[tuple[Any, ...], FloatArray] = {}
        self._scatter: dict[tuple[Any, ...], tuple[FloatArray, float]] = {}

    def best(self, phase: ExcitedPhase, frequency_hz: float, amplitude_mm: float) -> StepDesign:
        """The best captures at one excitation of a phase, next to the phase's own.

        Raises
        ------
        LabdaemonError
            The phase itself cannot be planned.
        """
        nominal_s = phase.exposure_s
        alone = _alone(phase, frequency_hz, amplitude_mm)
        own = self.design(alone, nominal_s)
        bounded: list[CaptureDesign] = []
        seen = {_group_key(own.step)}
        for candidate in self._candidates(alone):
            try:
                step = self._plan(candidate)
            except LabdaemonError:
                continue  # no exposure near it, a lamp that cannot play the code, or a code with a twin
            if _group_key(step) in seen:
                continue
            seen.add(_group_key(step))
            windows = self._windows(step)
            if self._is_usable(windows, nominal_s):
                bound = self._precision(step, windows, nominal_s, by_bound=True)
                bounded.append(CaptureDesign(candidate, step, windows, bound))
        best = own
        for one in sorted(bounded, key=lambda one: one.precision.per_root_time(self._goal)):
            if one.precision.per_root_time(self._goal) >= best.precision.per_root_time(self._goal):
                break  # none of the others is better than its bound
            whole = replace(one, precision=self._precision(one.step, one.windows, nominal_s))
            best = min(best, whole, key=lambda one: one.precision.per_root_time(self._goal))
        groups = max(int(own.precision.seconds * phase.captures / best.precision.seconds + 1e-6), 1)
        return StepDesign(frequency_hz, amplitude_mm, own, best, phase.captures, groups)

    def design(self, phase: StepsPhase, nominal_s: float) -> CaptureDesign:
        """A phase of one excitation with its predicted precision.

        Parameters
        ----------
        nominal_s
            Exposure at which the expected brightness holds.
        """
        step = self._plan(phase)
        windows = self._windows(step)
        return CaptureDesign(phase, step, windows, self._precision(step, windows, nominal_s))

    def _candidates(self, phase: StepsPhase) -> Iterator[StepsPhase]:
        steps_s = common_steps_s(self._rig.exposure_steps_s.values())
        plain: dict[str, Any] = {"phase_rad": None, "light": None, "light_phase_rad": 0.0, "expected_mm": None}
        for exposure_s in steps_s:
            ratio = exposure_s / phase.exposure_s
            if LEAST_WHITE <= ratio <= MOST_WHITE:
                if self._goal == "amplitude":  # whole cycles: knowing the phase as well adds nothing to it
                    yield phase.model_copy(update={**plain, "exposure_s": exposure_s})
                for openings in OPENINGS if self._goal == "phase" else ():
                    rounded = tuple(round(one, 4) for one in openings)
                    yield phase.model_copy(update={**plain, "exposure_s": exposure_s, "phase_rad": rounded})
            # A lamp that is dark for part of the cycle leaves room for a longer exposure.
            if self._goal == "phase" and self._rig.lamp is not None and 1.0 <= ratio <= 3.0 * MOST_WHITE:
                for code in CODES:
                    expected_mm = max(self._expectation.amplitudes_mm)
                    lit = {"light": code, "exposure_s": exposure_s, "expected_mm": expected_mm}
                    yield phase.model_copy(update=plain | lit)

    def _plan(self, phase: StepsPhase) -> Step:
        """One group of a phase, as the planner makes it."""
        section = CampaignSection.model_construct(name="design", notes="", repeats=1, phase=(phase,))
        plan = make_plan(Campaign(section, ""), self._rig)
        return next(step for step in plan.steps if step.kind != "sharp")

    def _windows(self, step: Step) -> tuple[ExposureWindow, ...]:
        frequency_hz, lamp = step.frequency_hz or 1.0, self._rig.lamp
        windows = []
        for shot in step.shots:
            light = None
            if shot.light is not None and lamp is not None:
                rise_rad = 2 * math.pi * frequency_hz * lamp.rise_s
                one = shot.light
                light = LightCode(one.brightness, one.phase_rad, one.cycles, lamp.ambient, rise_rad)
            sd_rad = 0.0 if shot.phase_rad is None else 2 * math.pi * frequency_hz * self._expectation.sd_opening_s
            windows.append(ExposureWindow(frequency_hz, shot.exposure_s, shot.phase_rad, sd_rad, light=light))
        return tuple(windows)

    def _is_usable(self, windows: Sequence[ExposureWindow], nominal_s: float) -> bool:
        """Whether the paper is neither too dark nor at white level, and the result without a flag."""
        for window in windows:
            white = window.exposure_s / nominal_s * light_fraction(window)
            if not LEAST_WHITE <= white <= MOST_WHITE:
                return False
        return not _has_part_cycles(windows)

    def _precision(
        self, step: Step, windows: Sequence[ExposureWindow], nominal_s: float, *, by_bound: bool = False
    ) -> GroupPrecision:
        expected = self._expectation
        seconds = sum(shot.exposure_s + self._rig.shot_s for shot in step.shots)
        if _has_part_cycles(windows):
            return GroupPrecision(math.inf, math.inf, seconds, 0.0)
        logs, ambiguous = list[FloatArray](), list[float]()
        for amplitude_mm in expected.amplitudes_mm:
            amplitude_px = amplitude_mm * expected.scale.px_per_mm
            phases = CODED_MOTION_PHASES if any(one.light for one in windows) else MOTION_PHASES
            bounds = []
            for phase_rad in phases:
                information = sum(
                    (self._information(window, amplitude_px, phase_rad, nominal_s) for window in windows),
                    np.zeros((4, 4)),
                )
                found = sd_of_information(information, amplitude_px, phase_rad)
                bounds.append((found.amplitude_px, found.phase_rad))
            squares, share = (FIT_OVER_BOUND * np.array(bounds)) ** 2, 0.0
            if not by_bound:
                added, share = self._scatter_beyond(
                    windows, amplitude_px, np.array(phases), np.array(bounds)[:, 1], nominal_s
                )
                squares = squares + added
            logs.append(0.5 * np.log(np.mean(squares, axis=0)))
            ambiguous.append(share)
        sds = np.exp(np.mean(logs, axis=0))
        return GroupPrecision(
            float(sds[0]) / expected.scale.px_per_mm, float(sds[1]), seconds, float(np.mean(ambiguous))
        )

    def _scatter_beyond(
        self,
        windows: Sequence[ExposureWindow],
        amplitude_px: float,
        phases_rad: FloatArray,
        bounds_rad: FloatArray,
        nominal_s: float,
    ) -> tuple[FloatArray, float]:
        """(2,) mean variances of amplitude and phase that the bounds do not know of, and the ambiguous share."""
        is_coded = any(one.light for one in windows)
        if not np.isfinite(bounds_rad).all() or not (is_coded or bounds_rad.max() > CURVED_RAD):
            return np.zeros(2), 0.0
        brightness = round(windows[0].exposure_s / nominal_s, 3)
        timing = tuple((round(one.cycles, 4), one.light, one.phase_rad) for one in windows)
        key = (*timing, brightness, round(amplitude_px, 4))
        if key not in self._scatter:
            # Few phases have neighbours, and those have most of the scatter: many phases, few draws of each.
            fine = (np.arange(SCATTER_PHASES) + 0.5) * np.pi / SCATTER_PHASES
            bound = np.exp(np.interp(fine, phases_rad, np.log(bounds_rad), period=np.pi))
            scatter = predict_scatter(windows, amplitude_px, fine, bound, self._expectation.image(brightness))
            beyond = np.maximum(scatter.phase_rad**2 - bound**2, 0.0)
            added = np.mean((scatter.amplitude_px**2, beyond), axis=1)
            self._scatter[key] = added, float(scatter.ambiguous.mean())
        return self._scatter[key]

    def _information(
        self, window: ExposureWindow, amplitude_px: float, phase_rad: float, nominal_s: float
    ) -> FloatArray:
        """(4, 4) information of one frame on the motion A·sin(ωt + ψ), from what is known of a frame like it.

        With the time's origin at an opening φ, the motion's phase is ψ + φ. Whole cycles show the same at any phase,
        and a code has its own origin.
        """
        if window.light is not None:
            origin_rad, plain = 0.0, window
        elif window.phase_rad is not None:
            origin_rad, plain = window.phase_rad, replace(window, phase_rad=0.0)
        else:
            origin_rad, plain = -phase_rad, ExposureWindow(1.0, 1.0)
        # A motion and its opposite are known equally well.
        seen_rad = round((phase_rad + origin_rad) % math.pi, 3)
        brightness = round(window.exposure_s / nominal_s, 3)
        timing = (round(plain.cycles, 4), plain.light, plain.sd_phase_rad)
        key = (*timing, brightness, round(amplitude_px, 4), seen_rad)
        if key not in self._known:
            vectors = motion_vectors(amplitude_px, seen_rad)
            self._known[key] = motion_information(plain, vectors, self._expectation.image(brightness))
        c, s = math.cos(origin_rad), math.sin(origin_rad)
        turn = np.kron(np.array([[c, -s], [s, c]]), np.eye(2))
        return np.asarray(turn.T @ self._known[key] @ turn)


def _alone(phase: ExcitedPhase, frequency_hz: float, amplitude_mm: float) -> StepsPhase:
    """One excitation of a phase, captured once (or in one group)."""
    shared = {name: getattr(phase, name) for name in _SHARED}
    return StepsPhase.model_construct(
        kind="steps", frequency_hz=frequency_hz, amplitude_mm=amplitude_mm, captures=1, **shared
    )


_SHARED = (
    "label",
    "on_fault",
    "not_before",
    "not_after",
    "exposure_s",
    "phase_rad",
    "settle",
    "light",
    "light_phase_rad",
    "expected_mm",
)


def _has_part_cycles(windows: Sequence[ExposureWindow]) -> bool:
    """Whether a frame will be flagged `part_cycles`: nothing says which part of the motion it has seen."""
    return any(one.phase_rad is None and one.light is None and one.fraction > LIMIT_CYCLES for one in windows)


def _group_key(step: Step) -> tuple[Any, ...]:
    return tuple((shot.exposure_s, shot.phase_rad, shot.light) for shot in step.shots)


def default_goal(phase: ExcitedPhase) -> Goal:
    """What a phase is for: the phase of the motion where it asks for openings at several phases, or for a code."""
    return "amplitude" if phase.phase_rad is None and phase.light is None else "phase"


def excitations(campaign: Campaign, rig: PlanRig) -> list[tuple[int, float, float]]:
    """Place of the phase in the file, frequency (Hz) and table's amplitude (mm) of each excitation, once each.

    Raises
    ------
    LabdaemonError
        The campaign cannot be planned.
    """
    found: dict[tuple[int, float, float], None] = {}
    for step in make_plan(campaign, rig).steps:
        excited = isinstance(campaign.section.phase[step.phase], StepsPhase | SweepPhase | DwellPhase)
        if excited and step.kind != "sharp" and step.frequency_hz is not None and step.amplitude_mm is not None:
            found[step.phase, step.frequency_hz, step.amplitude_mm] = None
    return list(found)


def spread_amplitudes(low_mm: float, high_mm: float) -> tuple[float, ...]:
    """Semi-amplitudes that stand for a range: its middle, or a quarter and three quarters of it in the logarithm."""
    if high_mm < 1.5 * low_mm:
        return (math.sqrt(low_mm * high_mm),)
    ratio = high_mm / low_mm
    return (low_mm * ratio**0.25, low_mm * ratio**0.75)
