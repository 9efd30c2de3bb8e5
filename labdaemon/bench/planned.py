"""Whether captures know what `labdaemon plan --optimise` predicts: designs simulated as planned, and measured.

A dot on textured paper is rendered for every exposure of a design, moved with a random phase, given a D80's noise and
measured as the folder would be. The scatter of amplitude and phase is compared with the predicted standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import click
import numpy as np

from labdaemon.bench.dots import DIFFRACTION_PX, OWN_LENS_SIGMA_PX
from labdaemon.bench.signed_error import interval_text, rms_interval, signed_error
from labdaemon.bench.simulator import Motion, Renderer, renderer
from labdaemon.blur import (
    Defocus,
    Dot,
    DotImage,
    ExposureWindow,
    FloatArray,
    LightCode,
    NoiseModel,
    Patch,
    SharpTarget,
    fit_sharp,
    light_fraction,
    measure_frame,
    measure_group,
)
from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.capture_design import Expectation, Goal, StepDesign
from labdaemon.campaign.fisher_plan import DesignSearch
from labdaemon.campaign.light_plan import ImageScale
from labdaemon.campaign.limits import ShakerLimits
from labdaemon.campaign.plan import PlanRig
from labdaemon.capture.exposure import third_stop_steps_s
from labdaemon.capture.lamp import Lamp

PX_PER_MM = 24.0 / 6.1
DOT_MM = 8.0
WHITE_DN = 2900.0
TEXTURE, TEXTURE_MM = 0.004, 0.3
LENS_SIGMA_PX = 1.25
NOISE = NoiseModel(7.0 / 8.5, 1.0 / 8.5, TEXTURE, TEXTURE_MM * PX_PER_MM / math.sqrt(2.0)).seen_through(LENS_SIGMA_PX)
SHARP_FRAMES, TRIALS_A_SHEET = 3, 3
FREQUENCY_HZ, NOMINAL_S = 5.0, 1.0
CASES: tuple[tuple[str, Goal, str, Lamp | None], ...] = (
    ("amplitude", "amplitude", "", None),
    ("phase by openings", "phase", "phase_rad = [0.0, 1.5708]\n", None),
    ("phase by code", "phase", 'light = "1110100"\n', Lamp(levels=2)),
    ("phase by pair", "phase", "phase_rad = [0.0, 1.5708]\n", Lamp(levels=256)),
)


@dataclass(frozen=True, slots=True)
class PlannedTrials:
    """What a number of trials of one design gave.

    Attributes
    ----------
    predicted_mm, predicted_rad
        Standard deviations as planned.
    errors_mm, errors_rad
        Errors of trials without a flag; none of a phase that is not predicted.
    phase_pulls
        Errors of the phase over the standard deviations that each trial states.
    flagged
        Trials with a flag: mostly twins under a code, between which several cameras decide.
    """

    predicted_mm: float
    predicted_rad: float
    errors_mm: FloatArray
    errors_rad: FloatArray
    phase_pulls: FloatArray
    flagged: int

    @property
    def amplitude_ratio(self) -> float:
        """Measured over predicted standard deviation of the amplitude."""
        return rms_interval(self.errors_mm / self.predicted_mm)[0]

    @property
    def phase_ratio(self) -> float:
        """The same of the phase; NaN where it does not show."""
        return rms_interval(self.errors_rad / self.predicted_rad)[0]


def plan_case(goal: Goal, extra: str, lamp: Lamp | None, amplitude_mm: float) -> StepDesign:
    """Plan one excitation as `labdaemon plan --optimise` does."""
    toml = (
        f'name = "planned"\n[[phase]]\nkind = "steps"\nfrequency_hz = {FREQUENCY_HZ}\n'
        f"amplitude_mm = {amplitude_mm}\nexposure_s = {NOMINAL_S}\n{extra}"
    )
    limits = ShakerLimits(150.0, 1000.0, 20_000.0, (0.5, 50.0))
    rig = PlanRig(limits, {"camera": third_stop_steps_s()}, lamp=lamp)
    dot = DotImage(
        lens_sigma_px=OWN_LENS_SIGMA_PX,
        white_dn=WHITE_DN,
        ink=0.05,
        noise=NOISE,
        sharp_frames=SHARP_FRAMES,
        diffraction_px=DIFFRACTION_PX,
    )
    expected = Expectation((amplitude_mm,), ImageScale(PX_PER_MM, DOT_MM), dot, sd_opening_s=0.0)
    phase = load_campaign(toml).section.phase[0]
    return DesignSearch(rig, expected, goal).best(phase, FREQUENCY_HZ, amplitude_mm)  # type: ignore[arg-type]


def run_planned(
    windows: Sequence[ExposureWindow],
    predicted: tuple[float, float],
    amplitude_mm: float,
    count: int,
    *,
    seed: int = 1,
) -> PlannedTrials:
    """Take the captures of a design `count` times, and measure each group.

    Parameters
    ----------
    windows
        The group's exposures.
    predicted
        Standard deviations of amplitude (mm) and phase (rad).

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    rng, render = np.random.default_rng(seed), renderer()
    camera = DotCamera(render, rng, amplitude_mm)
    shows_phase = math.isfinite(predicted[1])
    errors, flagged = [], 0
    for trial in range(count):
        if trial % TRIALS_A_SHEET == 0:
            camera.sheet += 1
            sharp = camera.sharp_target()
        phase_rad = math.pi * (trial + rng.uniform()) / count
        patches = [
            camera.photograph(camera.motion(window, phase_rad), exposure_brightness(window)) for window in windows
        ]
        still = Defocus(0.0, 0.1)
        if shows_phase:
            found = measure_group(sharp, patches, windows, defocus=still)
        else:
            found = measure_frame([sharp], patches, window=windows[0], defocus=still)[0]
        if found.flags:
            flagged += 1
            continue
        if not shows_phase:
            errors.append((found.amplitude_px / PX_PER_MM - amplitude_mm, 0.0, 0.0))
            continue
        vector, size = camera.direction_px, amplitude_mm * PX_PER_MM
        error = signed_error(found, size * np.concatenate((np.cos(phase_rad) * vector, np.sin(phase_rad) * vector)))
        errors.append((error.amplitude_px / PX_PER_MM, error.phase_rad, error.phase_pull))
    sizes, turns, pulls = np.array(errors).reshape(-1, 3).T
    if not shows_phase:
        turns = pulls = np.zeros(0)
    return PlannedTrials(*predicted, sizes, turns, pulls, flagged)


def exposure_brightness(window: ExposureWindow) -> float:
    """Light that an exposure gets, over that of `NOMINAL_S` at full brightness."""
    return window.exposure_s / NOMINAL_S * light_fraction(window)


class DotCamera:
    """A camera before one dot on textured paper.

    Parameters
    ----------
    render
        The renderer.
    rng
        Of the noise.
    amplitude_mm
        Largest motion that the patch has room for.
    """

    def __init__(self, render: Renderer, rng: np.random.Generator, amplitude_mm: float) -> None:
        self._render, self._rng = render, rng
        self._half = int(np.ceil((DOT_MM / 2 + amplitude_mm) * PX_PER_MM)) + 18
        self._amplitude_mm = amplitude_mm
        self.sheet: int = 0
        """Which sheet of paper the dot is on: each has a texture of its own."""
        self._direction = np.array([math.cos(0.5), 0.0, math.sin(0.5)])

    @property
    def direction_px(self) -> FloatArray:
        """(2,) unit vector of the motion in the image: z is up and y is down."""
        return np.array([self._direction[0], -self._direction[2]])

    def sharp_target(self) -> SharpTarget:
        """The dot at rest, by the mean of several frames."""
        patches = [self.photograph(None, 1.0) for _ in range(SHARP_FRAMES)]
        radius_px = DOT_MM / 2 * PX_PER_MM
        return fit_sharp(Dot(self._half + 0.3, self._half - 0.2, radius_px, radius_px, 0.0, name="T"), patches)

    def motion(self, window: ExposureWindow, phase_rad: float, scale: float = 1.0) -> Motion:
        """The motion over an exposure, by the light that it gets: time runs from 0 to 1 as light comes in."""
        angle_of = _angles(window)

        def displacement(t: FloatArray) -> FloatArray:
            along = scale * self._amplitude_mm * np.sin(angle_of(np.asarray(t, np.float64)) + phase_rad)
            return np.asarray(along[:, None] * self._direction, np.float64)

        return displacement

    def photograph(self, motion: Motion | None, brightness: float) -> Patch:
        """One frame with noise."""
        size = 2 * self._half + 1
        sheet = (size + 40) / PX_PER_MM
        target = {"name": "T", "centre_mm": (0.0, 0.0, 0.0), "diameter_mm": DOT_MM, "paper_mm": (sheet, sheet)}
        scene = {
            "targets": [target],
            "ink": 0.05,
            "texture": TEXTURE,
            "texture_length_mm": TEXTURE_MM,
            "gradient": (0.0, 0.0),
            "vignetting": 0.0,
            "clutter": 0,
            "seed": self.sheet,
        }
        camera = {
            "image_size": (size, size),
            "focal_px": (1000.0 * PX_PER_MM, 1000.0 * PX_PER_MM),
            "principal_point_px": (self._half + 0.3, self._half - 0.2),
            "position_mm": (0.0, -1000.0, 0.0),
        }
        motions = {} if motion is None else {"T": motion}
        frame = self._render(scene, camera, motions=motions, white_dn=WHITE_DN * brightness)
        image = np.asarray(frame.mean_dn, np.float64)
        image = image + self._rng.normal(size=image.shape) * np.sqrt(NOISE.variance(image))
        row, column = np.indices(image.shape)
        channel = np.asarray(2 * (row % 2) + column % 2, np.uint8)
        return Patch(image, channel, np.ones(image.shape, bool), (0, 0))


def _angles(window: ExposureWindow) -> Callable[[FloatArray], FloatArray]:
    """Excitation phase by the share of all light that has come in, 0 to 1."""
    light = window.light
    if light is None:
        opening = window.phase_rad or 0.0
        return lambda share: opening + 2 * math.pi * window.cycles * share
    fine = np.linspace(0.0, 2 * math.pi, 20_001) + light.phase_rad
    bright = light.at((fine[1:] + fine[:-1]) / 2) + light.ambient
    seen = np.concatenate(([0.0], np.cumsum(bright)))
    return lambda share: np.asarray(np.interp(share, seen / seen[-1], fine))


def with_known_light(window: ExposureWindow) -> ExposureWindow:
    """The window as `capture.toml` would have it: the code alone, with whole cycles."""
    light: LightCode | None = window.light
    return window if light is None else replace(window, exposure_s=light.cycles / window.frequency_hz)


@click.command("planned")
@click.option("--count", default=24, show_default=True, help="Groups of captures of each design.")
@click.option("--amplitude-mm", default=0.8, show_default=True, help="Semi-amplitude of the motion.")
@click.option("--seed", default=1, show_default=True)
def command(count: int, amplitude_mm: float, seed: int) -> None:
    """Captures as `plan --optimise` chooses them: measured over predicted standard deviations."""
    known: dict[str, PlannedTrials] = {}
    click.echo(
        "goal               captures                   predicted: mm, °    measured: mm, °"
        "            ratio mm              ratio °           phase pulls   flagged (predicted)"
    )
    for name, goal, extra, lamp in CASES:
        planned = plan_case(goal, extra, lamp, amplitude_mm)
        for which, design in (("now", planned.own), ("best", planned.best)):
            windows = [with_known_light(window) for window in design.windows]
            precision = design.precision
            key = repr(windows)
            if key not in known:
                predicted = (precision.sd_amplitude_mm, precision.sd_phase_rad)
                known[key] = run_planned(windows, predicted, amplitude_mm, count, seed=seed)
            found = known[key]
            shot = f"{which:<5}{len(windows)} × {design.windows[0].exposure_s:.3g} s"
            measured = rms_interval(found.errors_mm)[0], math.degrees(rms_interval(found.errors_rad)[0])
            click.echo(
                f"{name:<19}{shot:<20}{found.predicted_mm:>14.5f} {math.degrees(found.predicted_rad):>6.3f}"
                f"{measured[0]:>13.5f} {measured[1]:>6.3f}   {interval_text(found.errors_mm / found.predicted_mm)}   "
                f"{interval_text(found.errors_rad / found.predicted_rad)}   {interval_text(found.phase_pulls)}   "
                f"{found.flagged / count:.0%} ({precision.ambiguous:.0%})"
            )
