"""Dots of a real frame: errors and pulls against tracked motion, and which cause costs how much.

A frame that was rendered shows only what its author thought of. Here the dots of a real sharp frame, with their ink,
labels, gloss, lens and tone curve as they are, are moved by known amounts, one possible cause of error after the other.
They are moved by their own spectrum, averaged over instants: no formula of the fit is used. Next to it stand the errors
of the frame that was really blurred, and what its reference, half of a tracked path's peak to peak, reads too much.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import cv2
import numpy as np
from scipy import ndimage

from labdaemon.blur import Dot, FloatArray, InitialGuess, Measurement, Patch, SharpTarget, fit_sharp, measure_frame
from labdaemon.errors import DataError

REACH_PX = 36
"""Half size of the patches that are measured."""
MARGIN_PX = 20
"""Pixels around them that are moved, too: their mirrored ends stay outside."""
INSTANTS = 128
READ_DN = 60.0
"""Noise that is added, of 65 535 DN: a quarter of an 8-bit step, what the mean of 40 frames leaves."""
GAMMA = 2.2


@dataclass(frozen=True, slots=True)
class TrackedDot:
    """A dot of the real frame: number, group (a storey), rest and mean position, px, semi-amplitude, px, direction."""

    name: str
    group: str
    rest_px: tuple[float, float]
    centre_px: tuple[float, float]
    semi_amplitude_px: float
    direction_rad: float


@dataclass(frozen=True, slots=True)
class Cause:
    """One possible cause of error: how instants, blur and light of a moved dot differ from the model.

    Attributes
    ----------
    name
        For the table.
    instants
        Number of instants; the others are a continuous motion.
    third
        Third harmonic, relative.
    blur_px2
        Extra variance along and across the motion.
    still_gloss
        Whether the light on the label stays where it is while the label moves.
    gamma
        Exponent of a tone curve that is applied after the exposure instead of before.
    drift
        Relative change of the light over the exposure of five cycles and a flicker of the same depth.
    """

    name: str
    instants: int = INSTANTS
    third: float = 0.0
    blur_px2: tuple[float, float] = (0.0, 0.0)
    still_gloss: bool = False
    gamma: float = 1.0
    drift: float = 0.0


CAUSES = (
    Cause("nothing: ink, label, gloss, lens, tone curve and pixels of the frame as they are"),
    Cause("focus changed by 0.15 px²", blur_px2=(0.15, 0.15)),
    Cause("focus changed by 0.15 px² along, 0.20 px² across the motion", blur_px2=(0.15, 0.2)),
    Cause("the gloss stays in place while the label moves", still_gloss=True),
    Cause("tone curve after the exposure (gamma 2.2) instead of linear values", gamma=GAMMA),
    Cause("light drifts and flickers by 10 %", drift=0.1),
    Cause("third harmonic of 1 %", third=0.01),
    Cause("40 instants instead of a continuous motion", instants=40),
)


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Errors of unflagged amplitudes, px: number, median, robust spread, RMS pull, and how many were flagged."""

    count: int
    median_px: float
    spread_px: float
    pull: float
    flagged: int


def read_tracked(path: Path) -> list[TrackedDot]:
    """The dots of a `truth.csv`.

    Raises
    ------
    DataError
        The file is missing or has other columns.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return [_tracked(row) for row in csv.DictReader(stream)]
    except (OSError, KeyError, ValueError) as exc:
        raise DataError(f"no table of tracked dots ({exc}); see the bench's help for its columns", file=path) from exc


def _tracked(row: dict[str, str]) -> TrackedDot:
    def at(name: str) -> float:
        return float(row[name])

    return TrackedDot(
        row["target"],
        row["floor"],
        (at("rest_x_px"), at("rest_y_px")),
        (at("centre_x_px"), at("centre_y_px")),
        at("semi_amplitude_px"),
        float(np.radians(at("direction_deg"))),
    )


def cut_patch(image: FloatArray, centre_px: tuple[float, float], reach: int = REACH_PX) -> Patch:
    """The part of a grey image around a place, continued by its edge beyond the image."""
    x, y = round(centre_px[0]), round(centre_px[1])
    values = np.pad(image, reach, mode="edge")[y : y + 2 * reach + 1, x : x + 2 * reach + 1]
    return Patch(values.copy(), np.zeros(values.shape, np.uint8), values < 64_000, (x - reach, y - reach))


def moved_patch(
    image: FloatArray,
    dot: TrackedDot,
    amplitude_px: float,
    shift_px: FloatArray,
    cause: Cause,
    rng: np.random.Generator,
) -> Patch:
    """A dot of the sharp image after a motion of known amplitude about its rest position plus `shift_px` (2,)."""
    reach = REACH_PX + MARGIN_PX
    whole = cut_patch(image, dot.rest_px, reach)
    values, light = whole.values / 65_535.0, np.ones(whole.shape)
    if cause.still_gloss:
        light = _gloss(values, np.asarray(dot.rest_px) - np.asarray(whole.origin_px))
        values = values / light
    along = np.array([np.cos(dot.direction_rad), np.sin(dot.direction_rad)])
    theta = 2 * np.pi * (np.arange(cause.instants) + 0.5) / cause.instants
    course = np.sin(theta) + cause.third * np.sin(3 * theta)
    weight = 1 + cause.drift * (theta / (2 * np.pi) - 0.5 + np.sin(7 * theta + 1.0))
    blurred = light * _expose(values**cause.gamma, shift_px, np.outer(course, amplitude_px * along), weight, cause)
    blurred = np.maximum(blurred, 0.0) ** (1 / cause.gamma) * 65_535.0 + rng.normal(0, READ_DN, blurred.shape)
    inner = blurred[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    origin = (whole.origin_px[0] + MARGIN_PX, whole.origin_px[1] + MARGIN_PX)
    return Patch(inner, np.zeros(inner.shape, np.uint8), np.ones(inner.shape, bool), origin)


def _expose(
    values: FloatArray, shift_px: FloatArray, path_px: FloatArray, weight: FloatArray, cause: Cause
) -> FloatArray:
    """The image averaged over the path, (n, 2), and blurred; continued by its mirror image, so that nothing jumps."""
    height, width = values.shape
    tiled = np.block([[values, values[:, ::-1]], [values[::-1], values[::-1, ::-1]]])
    fy, fx = np.fft.fftfreq(2 * height), np.fft.fftfreq(2 * width)
    places = path_px + shift_px
    by_x, by_y = (np.exp(-2j * np.pi * np.outer(f, places[:, k])) for f, k in ((fx, 0), (fy, 1)))
    transfer = (by_y * weight) @ by_x.T / weight.sum()
    end = path_px[np.argmax(np.hypot(*path_px.T))]
    u = end / np.hypot(*end)
    along = fx[None] * u[0] + fy[:, None] * u[1]
    across = fx[None] * u[1] - fy[:, None] * u[0]
    transfer *= np.exp(-2 * np.pi**2 * (cause.blur_px2[0] * along**2 + cause.blur_px2[1] * across**2))
    result: FloatArray = np.fft.ifft2(np.fft.fft2(tiled) * transfer).real[:height, :width]
    return result


def _gloss(values: FloatArray, centre_px: FloatArray) -> FloatArray:
    """Brightness of the label, smooth, continued under the dot; 1 on average."""
    y, x = np.mgrid[: values.shape[0], : values.shape[1]]
    distance = np.hypot(x - centre_px[0], y - centre_px[1])
    paper = ((distance > 14) & (distance < 22)).astype(float)
    smooth = ndimage.gaussian_filter(values * paper, 6.0) / np.maximum(ndimage.gaussian_filter(paper, 6.0), 1e-6)
    level = float(np.mean(values[paper > 0]))
    result: FloatArray = np.where(distance < 26, smooth, level) / level
    return ndimage.gaussian_filter(result, 2.0)


def run_cause(
    image: FloatArray, dots: Sequence[TrackedDot], amplitude_px: float, cause: Cause, *, radius_px: float, seed: int = 1
) -> ErrorSummary:
    """Move real dots by a known amplitude and measure them as one frame."""
    rng = np.random.default_rng(seed)
    sharps, patches, guesses = [], [], []
    for dot in dots:
        shift = rng.uniform(-3, 3, 2)
        sharps.append(sharp_target(image, dot, radius_px))
        patches.append(moved_patch(image, dot, amplitude_px, shift, cause, rng))
        guesses.append(InitialGuess(np.asarray(dot.rest_px) + shift + rng.uniform(-1, 1, 2)))
    return summarise(measure_frame(sharps, patches, initial_guesses=guesses), [amplitude_px] * len(dots))


def sharp_target(image: FloatArray, dot: TrackedDot, radius_px: float) -> SharpTarget:
    """A dot at rest."""
    x, y = dot.rest_px
    return fit_sharp(Dot(x, y, radius_px, radius_px, 0.0, name=dot.name), [cut_patch(image, dot.rest_px)])


def measure_blurred(
    still: FloatArray, blurred: FloatArray, dots: Sequence[TrackedDot], radius_px: float
) -> list[Measurement]:
    """Measure the dots of the frame that was really blurred, as one frame."""
    sharps = [sharp_target(still, dot, radius_px) for dot in dots]
    guesses = [InitialGuess(np.asarray(dot.centre_px)) for dot in dots]
    return measure_frame(sharps, [cut_patch(blurred, dot.centre_px) for dot in dots], initial_guesses=guesses)


def summarise(found: Sequence[Measurement], true_px: Sequence[float]) -> ErrorSummary:
    """Errors and pulls of the unflagged ones."""
    pairs = [(one.amplitude_px - true, one.sd_px) for one, true in zip(found, true_px, strict=True) if not one.flags]
    if not pairs:
        return ErrorSummary(0, np.nan, np.nan, np.nan, len(found))
    error, sd = np.array(pairs).T
    middle = float(np.median(error))
    spread = 1.4826 * float(np.median(np.abs(error - middle)))
    return ErrorSummary(len(pairs), middle, spread, float(np.sqrt(np.mean((error / sd) ** 2))), len(found) - len(pairs))


def peak_to_peak_excess(
    amplitude_px: float, track_sd_px: float, frames: int, *, trials: int = 400, seed: int = 1
) -> float:
    """How much half the peak to peak of a noisy track exceeds the semi-amplitude, px, on average.

    A sinusoid spends most of its time near its ends; there the largest of many errors is added to the path.
    """
    rng = np.random.default_rng(seed)
    track = amplitude_px * np.sin(rng.uniform(0, 2 * np.pi, (trials, frames)))
    track = track + rng.normal(0, track_sd_px, track.shape)
    return float(np.mean(np.ptp(track, axis=1) / 2) - amplitude_px)


def _read_grey(path: Path) -> FloatArray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2:
        raise DataError("no grey image; is this the folder of a real frame with known motion?", file=path)
    return image.astype(np.float64) * (257.0 if image.dtype == np.uint8 else 1.0)


def _line(name: str, one: ErrorSummary) -> str:
    return f"{name:72s} {one.count:3d} {one.flagged:8d} {one.median_px:+8.4f} {one.spread_px:7.4f} {one.pull:6.2f}"


def _print_blurred(folder: Path, dots: Sequence[TrackedDot], radius_px: float) -> None:
    found = measure_blurred(_read_grey(folder / "sharp.png"), _read_grey(folder / "blurred.png"), dots, radius_px)
    groups = sorted({dot.group for dot in dots})
    for group in groups:
        here = [k for k, dot in enumerate(dots) if dot.group == group]
        one = summarise([found[k] for k in here], [dots[k].semi_amplitude_px for k in here])
        size = np.median([dots[k].semi_amplitude_px for k in here])
        click.echo(_line(f"the frame as blurred, group {group}, {size:.2f} px", one))
    click.echo(_line("the frame as blurred, all", summarise(found, [dot.semi_amplitude_px for dot in dots])))


def _print_reference(amplitudes_px: Sequence[float]) -> None:
    click.echo("half of a noisy track's peak to peak less its semi-amplitude, px")
    click.echo("amplitude px  track sd px  frames   excess px")
    for amplitude in amplitudes_px:
        for sd in (0.01, 0.02, 0.035):
            for frames in (40, 200):
                excess = peak_to_peak_excess(amplitude, sd, frames)
                click.echo(f"{amplitude:12.1f} {sd:12.3f} {frames:7d} {excess:+11.4f}")


@click.command("real")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--amplitude", "amplitudes", type=float, multiple=True, default=(1.5, 3.0), show_default=True, help="px")
@click.option("--groups", default="1,2,3", show_default=True, help="Groups of dots (column floor) that are moved.")
@click.option("--radius", default=10.5, show_default=True, help="Radius of the dots, px.")
@click.option("--cause", "numbers", type=int, multiple=True, help="Only these lines of causes, from 1.")
@click.option("--seed", default=1, show_default=True)
@click.option("--blurred/--no-blurred", default=True, show_default=True, help="The frame that was really blurred.")
def command(
    folder: Path,
    amplitudes: tuple[float, ...],
    groups: str,
    radius: float,
    numbers: tuple[int, ...],
    seed: int,
    blurred: bool,
) -> None:
    """Dots of a real frame, moved by known amounts: what each possible cause costs.

    FOLDER holds sharp.png, blurred.png (grey) and truth.csv with the columns target, floor, rest_x_px, rest_y_px,
    centre_x_px, centre_y_px, semi_amplitude_px, direction_deg.
    """
    dots = read_tracked(folder / "truth.csv")
    click.echo(f"{'':72s} {'n':>3s} {'flagged':>8s} {'median':>8s} {'spread':>7s} {'pull':>6s}")
    if blurred:
        _print_blurred(folder, dots, radius)
    still = _read_grey(folder / "sharp.png")
    chosen = [dot for dot in dots if dot.group in groups.split(",")]
    for amplitude in amplitudes:
        for number, cause in enumerate(CAUSES, 1):
            if not numbers or number in numbers:
                one = run_cause(still, chosen, amplitude, cause, radius_px=radius, seed=seed)
                click.echo(_line(f"{amplitude:.1f} px, {cause.name}", one))
    _print_reference(amplitudes)
