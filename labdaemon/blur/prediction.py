"""How well a capture will know a motion, before it is taken: the Cramér–Rao bound of a dot's image.

The modelled image of a dot (``smear.forward_model``) has derivatives J by the motion and by what is unknown in each
frame: position, defocus, paper white, contrast, a slope of the light, and the timing where it has an uncertainty. With
the pixels' covariance C the information of a frame is Jᵀ C⁻¹ J. What belongs to one frame alone is eliminated from it,
the information on the motion adds up over the frames of a group, and its inverse is the least covariance that any
unbiased measurement can have. C holds photon noise, read noise, and the paper's texture, which moves with the dot and
is blurred as it is. The sharp frames show the texture, too: where its power is S and theirs of noise N, both relative
to the paper's brightness squared, S·N/(S + N) of it stays unknown (Wiener). That frames of a group share this rest
changes the bound by 4 % at most, and what the motion of the texture itself says of the motion by less than 1 %.

The fits of this package reach about 1.0 to 1.3 times the bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import fft

from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray, NoiseModel
from labdaemon.blur.sharp.texture_map import texture_power
from labdaemon.blur.spectra.closed_form import diffraction_transfer, ellipse_spectrum, gaussian_transfer, pixel_transfer
from labdaemon.blur.waveform import quadrature_transfer, window_nodes
from labdaemon.errors import UsageError

LENS_SIGMA_PX = 0.8
"""A sharp lens."""

D80_NOISE = NoiseModel(read_dn=7.0 / 8.5, gain_dn=1.0 / 8.5, texture=0.004, texture_px=0.83).seen_through(LENS_SIGMA_PX)
"""A Nikon D80 at ISO 100 and a sheet of matt paper (0.4 %, correlated over 0.3 mm) seen from 1 m."""

DEFOCUS_SD_PX2 = 0.1
"""How well control targets know a frame's defocus: a prior, without which small motions look less certain than they
are."""

MARGIN_PX = 6.0
"""Paper around the blurred dot that takes part."""

UNSEEN = 1e-9
"""Information of a parameter, relative to the largest, below which the image does not show it."""

_STEP = 1e-4


@dataclass(frozen=True, slots=True)
class DotImage:
    """What a camera sees of a dot at rest.

    Attributes
    ----------
    radius_px
        Radius of the dot.
    lens_sigma_px
        Standard deviation of the lens' blur.
    white_dn
        Paper white, mean of the colours, DN above black, with the lamp at full brightness for the whole exposure.
    ink
        Reflectance of the dot relative to the paper.
    noise
        Noise of the pixels, and the paper's texture as the lens shows it (`NoiseModel.seen_through`).
    sharp_frames
        Number of frames at rest that show the texture; 0 where it is all unknown.
    sd_defocus_px2
        How well a frame's defocus is known beforehand.
    diffraction_px
        Wavelength times f-number (2.9 px in green at f/32 on a D80); 0 where the Gaussian is all. A Gaussian in its
        place, of the same width, promises 1.2 times more.
    """

    radius_px: float = 15.7
    lens_sigma_px: float = LENS_SIGMA_PX
    white_dn: float = 2400.0
    ink: float = 0.06
    noise: NoiseModel = D80_NOISE
    sharp_frames: int = 1
    sd_defocus_px2: float = DEFOCUS_SD_PX2
    diffraction_px: float = 0.0

    @property
    def map_noise(self) -> float:
        """Power of the sharp frames' own noise, relative to the paper's brightness squared, px²; inf without any."""
        if self.sharp_frames < 1:
            return float("inf")
        return float(self.noise.variance(np.array(self.white_dn))) / self.white_dn**2 / self.sharp_frames


@dataclass(frozen=True, slots=True, eq=False)
class PredictedSd:
    """Least standard deviations of the motion d = A·u·sin(ωt + ψ), u along `direction`.

    A quantity that the images do not show has an infinite standard deviation.

    Attributes
    ----------
    amplitude_px
        Of the semi-amplitude A.
    phase_rad
        Of the phase ψ.
    direction_rad
        Of the direction of u in the image.
    covariance_px2
        (4, 4) of (ax, ay, bx, by); infinite variances where the phase does not show.
    """

    amplitude_px: float
    phase_rad: float
    direction_rad: float
    covariance_px2: FloatArray = field(repr=False)


def predict_sd(
    exposures: Sequence[ExposureWindow],
    amplitude_px: float,
    phase_rad: float,
    dot: DotImage | None = None,
    *,
    direction_rad: float = 0.5,
) -> PredictedSd:
    """Predict the standard deviation of one target's motion from a group of captures, before they are taken.

    Any exposure is understood: whole cycles (the phase does not show), part cycles at known phases, coded light.

    Parameters
    ----------
    exposures
        Windows of the group's captures, with their light; a single one for a capture on its own.
    amplitude_px, phase_rad
        Semi-amplitude A and phase ψ of the motion A·sin(ωt + ψ) that is expected, in the image.
    dot
        The dot's image; by default an 8 mm dot on white paper before a D80 at 1 m.
    direction_rad
        Direction of the motion in the image, from x towards y.

    Returns
    -------
    PredictedSd
        The Cramér–Rao bound.

    Raises
    ------
    UsageError
        No exposure, or an amplitude that is not positive.
    """
    if not exposures or not 0 < amplitude_px < np.inf:
        raise UsageError("a prediction needs an exposure, and an amplitude above zero")
    dot = dot or DotImage()
    vectors = motion_vectors(amplitude_px, phase_rad, direction_rad)
    information = sum((motion_information(window, vectors, dot) for window in exposures), np.zeros((4, 4)))
    return sd_of_information(information, amplitude_px, phase_rad, direction_rad=direction_rad)


def motion_vectors(amplitude_px: float, phase_rad: float, direction_rad: float = 0.5) -> FloatArray:
    """(4,) ax, ay, bx, by of the motion A·u·sin(ωt + ψ)."""
    return amplitude_px * _motion_axes(phase_rad, direction_rad)[:, 0]


def _motion_axes(phase_rad: float, direction_rad: float) -> FloatArray:
    """(4, 4) columns: amplitude, phase (times A), direction (times A), minor axis; rows: ax, ay, bx, by."""
    along = np.array([np.cos(direction_rad), np.sin(direction_rad)])
    across = np.array([-along[1], along[0]])
    sine, cosine = np.cos(phase_rad), np.sin(phase_rad)  # of A sin(ωt + ψ) = A cos ψ · sin ωt + A sin ψ · cos ωt
    return np.stack(
        [
            np.concatenate((sine * along, cosine * along)),
            np.concatenate((-cosine * along, sine * along)),
            np.concatenate((sine * across, cosine * across)),
            np.concatenate((-cosine * across, sine * across)),
        ],
        axis=1,
    )


def sd_of_information(
    information: FloatArray, amplitude_px: float, phase_rad: float, *, direction_rad: float = 0.5
) -> PredictedSd:
    """The bound from the sum of the frames' `motion_information` (4, 4) at this motion."""
    turn = _motion_axes(phase_rad, direction_rad)
    covariance = _invert(turn.T @ information @ turn)
    root = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        full = turn @ np.where(np.isfinite(covariance), covariance, 0.0) @ turn.T
    lost = turn[:, ~np.isfinite(root)]
    full[np.abs(lost @ lost.T) > UNSEEN] = np.inf
    return PredictedSd(float(root[0]), float(root[1]) / amplitude_px, float(root[2]) / amplitude_px, full)


def motion_information(window: ExposureWindow, vectors: FloatArray, dot: DotImage) -> FloatArray:
    """Fisher's information (4, 4) of one frame on (ax, ay, bx, by), px⁻², with all else in the frame unknown.

    Parameters
    ----------
    window
        The exposure.
    vectors
        (4,) the motion ax, ay, bx, by, px.
    dot
        The dot's image.
    """
    derivatives, covariance, prior = _frame_derivatives(window, vectors, dot)
    weighted = covariance.solve(derivatives)
    normal = np.einsum("iyx,jyx->ij", derivatives, weighted)
    normal[np.diag_indices_from(normal)] += prior
    by_motion, shared, own = normal[:4, :4], normal[:4, 4:], normal[4:, 4:]
    scale = np.sqrt(np.diag(own))
    eliminated = shared / scale @ np.linalg.solve(own / np.outer(scale, scale), (shared / scale).T)
    return np.asarray(by_motion - eliminated)


def light_fraction(window: ExposureWindow) -> float:
    """Light of an exposure relative to one of the same length with lamp and ambient light on throughout."""
    light = window.light
    if light is None:
        return 1.0
    played = light.cycles * float(light.lamp_nodes(0.0)[1].sum())
    return (played + light.ambient * window.cycles) / ((1.0 + light.ambient) * window.cycles)


def _frame_derivatives(
    window: ExposureWindow, vectors: FloatArray, dot: DotImage
) -> tuple[FloatArray, _PixelCovariance, FloatArray]:
    """Derivatives of the image by motion and by the frame's own unknowns, its covariance, and prior information."""
    reach = float(np.hypot(*vectors.reshape(2, 2)).max())
    skirt = 3 * max(dot.lens_sigma_px, 0.5 * dot.diffraction_px)
    size = fft.next_fast_len(2 * int(np.ceil(dot.radius_px + reach + skirt + MARGIN_PX)) + 1)
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    square = fx**2 + fy**2
    sharp = ellipse_spectrum(fx, fy, np.array([dot.radius_px, 0.0, dot.radius_px]))[0]
    sharp = sharp * gaussian_transfer(square, dot.lens_sigma_px**2) * pixel_transfer(fx, fy)
    if dot.diffraction_px > 0:
        sharp = sharp * diffraction_transfer(np.sqrt(square), dot.diffraction_px)
    basis, weight = window_nodes(window, reach)
    transfer, by_motion = quadrature_transfer(fx, fy, vectors, basis, weight)
    by_timing, timing_prior = _timing_derivatives(window, vectors, reach, fx, fy)

    def image(spectrum: ComplexArray) -> FloatArray:
        return np.asarray(np.fft.fftshift(np.fft.ifft2(sharp * spectrum).real, axes=(-2, -1)))

    darkness = image(transfer)
    place = np.stack((-2j * np.pi * fx, -2j * np.pi * fy, -2 * np.pi**2 * square)) * transfer
    white = dot.white_dn * light_fraction(window)
    contrast = 1.0 - dot.ink
    paper = 1.0 - contrast * darkness
    offset = (np.arange(size) - size // 2) / size
    by_place = -white * contrast * image(place)
    by_light = white * np.stack((paper, -darkness, paper * offset, paper * offset[:, None]))
    timing = -white * contrast * image(np.stack(by_timing)) if by_timing else np.zeros((0, size, size))
    derivatives = np.concatenate((-white * contrast * image(by_motion), by_place, by_light, timing))
    prior = np.concatenate((np.zeros(6), [dot.sd_defocus_px2**-2], np.zeros(4), timing_prior))
    return derivatives, _PixelCovariance(white * paper, dot, window, vectors, reach), prior


def _timing_derivatives(
    window: ExposureWindow, vectors: FloatArray, reach: float, fx: FloatArray, fy: FloatArray
) -> tuple[list[ComplexArray], FloatArray]:
    """Derivatives of the transfer function by what is uncertain of the timing and the light, and their priors."""
    light = window.light
    varied: list[tuple[float, ExposureWindow, ExposureWindow]] = []
    if window.sd_phase_rad > 0 and window.phase_rad is not None and (light is None or light.ambient > 0):
        ends = [replace(window, phase_rad=window.phase_rad + step) for step in (_STEP, -_STEP)]
        varied.append((window.sd_phase_rad, ends[0], ends[1]))
    if window.sd_exposure_s > 0 and light is None:
        step = _STEP * window.exposure_s
        ends = [replace(window, exposure_s=window.exposure_s + sign * step) for sign in (1, -1)]
        varied.append((window.sd_exposure_s * _STEP / step, ends[0], ends[1]))
    if light is not None and light.sd_phase_rad > 0:
        ends = [replace(window, light=replace(light, phase_rad=light.phase_rad + step)) for step in (_STEP, -_STEP)]
        varied.append((light.sd_phase_rad, ends[0], ends[1]))
    if light is not None and light.sd_ambient > 0:
        least = max(light.ambient - _STEP, 0.0)  # there is no less than none
        ends = [replace(window, light=replace(light, ambient=value)) for value in (least + 2 * _STEP, least)]
        varied.append((light.sd_ambient, ends[0], ends[1]))
    found: list[ComplexArray] = []
    for _, after, before in varied:
        parts = [quadrature_transfer(fx, fy, vectors, *window_nodes(one, reach))[0] for one in (after, before)]
        found.append((parts[0] - parts[1]) / (2 * _STEP))
    return found, np.array([sd**-2 for sd, _, _ in varied])


class _PixelCovariance:
    """C = D + M K M: independent noise D, and the unknown part K of the blurred texture, scaled by the brightness M."""

    def __init__(
        self, bright: FloatArray, dot: DotImage, window: ExposureWindow, vectors: FloatArray, reach: float
    ) -> None:
        self._bright, self._variance = bright, dot.noise.variance(bright)
        self._spectrum: FloatArray | None = None
        if dot.noise.texture <= 0:
            return
        # Twice the size, so that texture at one edge does not reach the other.
        size = 2 * bright.shape[0]
        fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.rfftfreq(size), indexing="ij")
        basis, weight = window_nodes(window, reach)
        transfer = quadrature_transfer(fx, fy, vectors, basis, weight)[0]
        power, map_noise = texture_power(dot.noise, fx**2 + fy**2), dot.map_noise
        unknown = power / (1 + power / map_noise)
        self._spectrum = unknown * np.abs(transfer) ** 2

    def solve(self, right: FloatArray) -> FloatArray:
        """C⁻¹ applied to images (n, h, w), by conjugate gradients preconditioned with the independent noise."""
        x = right / self._variance
        if self._spectrum is None:
            return x
        residual = right - self._times(x)
        z = residual / self._variance
        direction, rho = z, np.sum(residual * z, axis=(1, 2))
        start = np.sum(right * right / self._variance, axis=(1, 2))
        for _ in range(100):
            product = self._times(direction)
            step = rho / np.maximum(np.sum(direction * product, axis=(1, 2)), 1e-300)
            x = x + step[:, None, None] * direction
            residual = residual - step[:, None, None] * product
            z = residual / self._variance
            now = np.sum(residual * z, axis=(1, 2))
            if np.all(now < 1e-8 * start):
                break
            direction = z + (now / np.maximum(rho, 1e-300))[:, None, None] * direction
            rho = now
        return x

    def _times(self, images: FloatArray) -> FloatArray:
        assert self._spectrum is not None
        height, width = images.shape[1:]
        spectrum = fft.rfft2(self._bright * images, (2 * height, 2 * width)) * self._spectrum
        texture = fft.irfft2(spectrum, (2 * height, 2 * width))[:, :height, :width]
        return np.asarray(self._variance * images + self._bright * texture)


def _invert(information: FloatArray) -> FloatArray:
    """Covariance; infinite variance (and no covariance) for a parameter that the images do not show."""
    size = np.diag(information)
    shown = size > UNSEEN * size.max()
    covariance = np.zeros_like(information)
    scale = np.sqrt(np.where(shown, size, 1.0))
    part = (information / np.outer(scale, scale))[np.ix_(shown, shown)]
    values, axes = np.linalg.eigh(part)
    # Directions without information make infinite whatever has a share in them.
    known = values > 1e-7
    inverse = (axes[:, known] / values[known]) @ axes[:, known].T
    lost = np.sum(axes[:, ~known] ** 2, axis=1) > 1e-6
    inverse[lost, lost] = np.inf
    covariance[np.ix_(shown, shown)] = inverse / np.outer(scale[shown], scale[shown])
    hidden = np.flatnonzero(~shown)
    covariance[hidden, hidden] = np.inf
    return covariance
