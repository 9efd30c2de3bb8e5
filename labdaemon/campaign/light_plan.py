"""Coded light in a plan: which exposure and how many cycles, what it will know, and which codes are refused.

A code must be played in whole cycles while all shutters are open. Codes that together have a twin, another motion with
the same images, are refused; the distance to the nearest one is searched over all phases and amplitudes
(`labdaemon.blur.nearest_twin`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from labdaemon.campaign.steps import LightPrecision, Shot
from labdaemon.capture.exposure import choose_lit_exposure
from labdaemon.capture.lamp import Lamp, LightRequest
from labdaemon.errors import ConfigError, LimitError, UsageError

if TYPE_CHECKING:
    from labdaemon.blur import ExposureWindow

Code = tuple[float, ...]

SECTORS = (2, 64)
SHORTEST_SECTOR_S = 1e-4
TWIN_SD = 4.0
"""Codes whose nearest twin is nearer than this, in standard deviations of one target's image, have a twin."""
TWIN_PX = 5.0
"""Semi-amplitude at which that is judged: what is equal there is equal at any amplitude."""
NEAR_TWIN_SD = 3.0
"""At the amplitude that is expected: nearer than this a target in fifteen may be `ambiguous`."""
PAIR_BELOW_PX = 2.0
"""Below this image motion a cosine-sine pair is the better choice."""
FLICKER_PERIODS = 20
"""In fewer periods of a flicker, a part period changes the mean by more than one part in fifty."""
LENS_SIGMA_PX = 0.8


@dataclass(frozen=True, slots=True)
class ImageScale:
    """How large things are in the images, as far as it is known before any frame.

    Attributes
    ----------
    px_per_mm
        Of the camera that sees them smallest.
    dot_mm
        Diameter of the smallest dots.
    """

    px_per_mm: float = 3.9
    dot_mm: float = 8.0


@dataclass(frozen=True, slots=True)
class LightPlan:
    """Captures of one group under coded light.

    Attributes
    ----------
    shots
        One for each code.
    precision
        What the group will know; None where it was not predicted.
    notes
        What a person should know before it runs.
    """

    shots: tuple[Shot, ...]
    precision: LightPrecision | None
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LitExcitation:
    """What is to be seen under a group of codes.

    Attributes
    ----------
    codes
        Brightness in equal sectors, one code for each capture.
    phase_rad
        Excitation phase at which the first sector begins.
    nominal_s
        Exposure that is asked for.
    expected_mm
        Largest semi-amplitude that is expected on the structure.
    """

    codes: tuple[Code, ...]
    phase_rad: float
    nominal_s: float
    frequency_hz: float
    expected_mm: float


def lit_shots(lit: LitExcitation, lamp: Lamp | None, steps_s: Sequence[float]) -> tuple[Shot, ...]:
    """Choose exposure and cycles, without a prediction of what the group will know.

    Raises
    ------
    ConfigError
        The rig has no lamp, or the lamp cannot show the code.
    LimitError
        No exposure near the nominal one has room for a whole cycle.
    """
    lamp = _check(lit, lamp)
    sectors = min(len(code) for code in lit.codes)
    chosen = choose_lit_exposure(
        steps_s, lit.nominal_s, lambda exposure_s: lamp.cycles_within(exposure_s, lit.frequency_hz, sectors)
    )
    if chosen is None:
        need_s = (1 + 1 / sectors) / lit.frequency_hz + lamp.margin_s
        if lit.nominal_s > max(steps_s, default=math.inf):
            raise LimitError(f"the cameras offer no exposure near {lit.nominal_s:g} s, {max(steps_s):g} s at most")
        raise LimitError(
            f"no whole cycle of the code fits into an exposure near {lit.nominal_s:g} s: one takes {need_s:.3g} s with "
            "the wait for its beginning and the shutters' margin; expose longer"
        )
    exposure_s, cycles = chosen
    return tuple(
        Shot(exposure_s, exposure_s * lit.frequency_hz, light=LightRequest(code, cycles, lit.phase_rad))
        for code in lit.codes
    )


def plan_light(lit: LitExcitation, lamp: Lamp | None, steps_s: Sequence[float], scale: ImageScale) -> LightPlan:
    """Choose exposure and cycles, and predict what the group will know.

    Parameters
    ----------
    steps_s
        Exposure times that all cameras offer.

    Raises
    ------
    ConfigError
        The rig has no lamp, the lamp cannot show the code, or the codes together have a twin.
    LimitError
        No exposure near the nominal one has room for a whole cycle.
    """
    lamp = _check(lit, lamp)
    shots = lit_shots(lit, lamp, steps_s)
    amplitude_px = _two_figures(max(lit.expected_mm, 1e-3) * scale.px_per_mm)
    try:
        precision, twin_sd = _precision(shots, lit.frequency_hz, lamp, amplitude_px, scale)
    except UsageError as exc:
        raise ConfigError(str(exc)) from None
    if twin_sd < TWIN_SD:
        names = " and ".join(_code_name(code) for code in lit.codes)
        raise ConfigError(
            f"{names}: another motion of different phase leaves the same images (a twin, {twin_sd:.1f} standard "
            'deviations away), so the sign of no motion could be known; take light = "1110100", or a pair as '
            'light = ["cos", "sin"]'
        )
    return LightPlan(shots, precision, _notes(lit, lamp, shots, precision))


def _check(lit: LitExcitation, lamp: Lamp | None) -> Lamp:
    """The lamp, if it can play the codes."""
    if lamp is None:
        raise ConfigError(
            "plays a light code, but the rig has no [lamp] that its trigger can play; take a trigger with a lamp "
            "output (driver box) and add [lamp], or leave light out"
        )
    for code in lit.codes:
        if not SECTORS[0] <= len(code) <= SECTORS[1]:
            raise ConfigError(f"a code has {SECTORS[0]} to {SECTORS[1]} sectors, {_code_name(code)} has {len(code)}")
        if lamp.levels == 2 and any(value not in (0.0, 1.0) for value in code):
            raise ConfigError(
                f"{_code_name(code)} has levels between dark and full brightness, and the lamp only switches; give "
                "bits as 1110100, or a lamp with PWM and its `levels`"
            )
        if max(code) - min(code) < 1 / 255:
            raise ConfigError(f"{_code_name(code)} is constant light, which shows no phase; leave it out")
        if 1 / lit.frequency_hz / len(code) < SHORTEST_SECTOR_S:
            raise ConfigError(f"a sector of {_code_name(code)} at {lit.frequency_hz:g} Hz is shorter than 0.1 ms")
    return lamp


def _precision(
    shots: tuple[Shot, ...], frequency_hz: float, lamp: Lamp, amplitude_px: float, scale: ImageScale
) -> tuple[LightPrecision, float]:
    """What the group will know, and the distance to its nearest twin at a larger amplitude."""
    lights = tuple(shot.light for shot in shots if shot.light is not None)
    cycles = round(shots[0].exposure_s * frequency_hz, 2)
    rise_rad = round(2 * math.pi * frequency_hz * lamp.rise_s, 5)
    radius_px = _two_figures(scale.dot_mm / 2 * scale.px_per_mm)
    group = (lights, cycles, (lamp.ambient, lamp.assumed_sd_ambient), rise_rad, radius_px)
    median, worst, amplitude = _predicted(*group, amplitude_px)
    here = _twin_distance(*group, amplitude_px)
    larger = here if amplitude_px >= TWIN_PX else _twin_distance(*group, TWIN_PX)
    precision = LightPrecision(
        amplitude_px, amplitude_px / scale.px_per_mm, amplitude, amplitude / scale.px_per_mm, median, worst, here
    )
    return precision, larger


@lru_cache(maxsize=512)
def _predicted(
    lights: tuple[LightRequest, ...],
    cycles: float,
    ambient: tuple[float, float],
    rise_rad: float,
    radius_px: float,
    amplitude_px: float,
) -> tuple[float, float, float]:
    """Median and worst sd of the phase over the motion's phases, and the median of the amplitude's."""
    # The daemon must bring the table to rest before it loads what measuring needs.
    import numpy as np

    from labdaemon.blur import DotImage, NoiseModel, predict_sd

    # Without paper texture, which costs a few per cent here and most of the time.
    dot = DotImage(radius_px, LENS_SIGMA_PX, noise=NoiseModel(7.0 / 8.5, 1 / 8.5))
    windows = _windows(lights, cycles, ambient, rise_rad)
    # Over half a turn: a motion and its opposite are known equally well.
    found = [predict_sd(windows, amplitude_px, float(phase), dot) for phase in (np.arange(6) + 0.25) / 6 * np.pi]
    phases = [one.phase_rad for one in found]
    return float(np.median(phases)), max(phases), float(np.median([one.amplitude_px for one in found]))


@lru_cache(maxsize=512)
def _twin_distance(
    lights: tuple[LightRequest, ...],
    cycles: float,
    ambient: tuple[float, float],
    rise_rad: float,
    radius_px: float,
    amplitude_px: float,
) -> float:
    from labdaemon.blur import DotImage, nearest_twin

    dot = DotImage(radius_px, LENS_SIGMA_PX)
    return nearest_twin(_windows(lights, cycles, ambient, rise_rad), amplitude_px, dot).distance_sd


def _windows(
    lights: tuple[LightRequest, ...], cycles: float, ambient: tuple[float, float], rise_rad: float
) -> list[ExposureWindow]:
    """The captures' windows; `ambient` is its share and the standard deviation of that."""
    from labdaemon.blur import ExposureWindow, LightCode

    share, sd = ambient
    codes = [LightCode(one.brightness, one.phase_rad, one.cycles, share, rise_rad, sd_ambient=sd) for one in lights]
    return [ExposureWindow(1.0, cycles, light=code) for code in codes]


def _notes(lit: LitExcitation, lamp: Lamp, shots: tuple[Shot, ...], precision: LightPrecision) -> tuple[str, ...]:
    """What a person should know."""
    notes: list[str] = []
    at = f"{lit.frequency_hz:g} Hz, {precision.amplitude_px:.2g} px expected"
    if len(lit.codes) == 1 and precision.amplitude_px < PAIR_BELOW_PX:
        notes.append(f'{at}: below {PAIR_BELOW_PX:g} px the pair light = ["cos", "sin"] is the better choice')
    elif precision.twin_sd < NEAR_TWIN_SD:
        notes.append(
            f"{at}: the nearest twin is {precision.twin_sd:.1f} standard deviations away; targets may be `ambiguous`"
        )
    flicker = _flicker_note(lit.frequency_hz, shots[0].exposure_s, lamp, precision.amplitude_px)
    return (*notes, *([f"{at}: {flicker}"] if flicker else []))


def _flicker_note(frequency_hz: float, exposure_s: float, lamp: Lamp, amplitude_px: float) -> str | None:
    """Flicker of the room's light that acts like a code of its own.

    A motion of A px shows harmonics of the light up to about 2π·0.35·A: beyond, the Bessel functions of the image's
    frequencies are small.
    """
    if lamp.flicker_hz is None or lamp.ambient <= 0:
        return None
    order = round(lamp.flicker_hz / frequency_hz)
    beat_hz = abs(lamp.flicker_hz - order * frequency_hz)
    if 1 <= order <= math.ceil(2.2 * amplitude_px) + 1 and beat_hz * exposure_s < 1.0:
        return (
            f"the room's light flickers at {lamp.flicker_hz:g} Hz, {beat_hz:.2g} Hz from harmonic {order} of the "
            "excitation: it acts like a code that is not known; use DC light, or another frequency"
        )
    if lamp.flicker_hz * exposure_s < FLICKER_PERIODS:
        return (
            f"the exposure holds {lamp.flicker_hz * exposure_s:.1f} periods of the room's light, which flickers at "
            f"{lamp.flicker_hz:g} Hz: its share is not constant; use DC light"
        )
    return None


def _code_name(code: Code) -> str:
    """A code as a person writes it."""
    if all(value in (0.0, 1.0) for value in code):
        return "".join(str(int(value)) for value in code)
    return f"a code of {len(code)} levels"


def _two_figures(value: float) -> float:
    """Two significant figures: what is predicted for one of a sweep's steps holds for its neighbours, too."""
    return float(f"{value:.1e}")
