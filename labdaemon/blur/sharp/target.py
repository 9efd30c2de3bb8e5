"""A target at rest: everything about it that later fits need, worked out once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labdaemon.blur.patch.colour_planes import FrequencyGrid
from labdaemon.blur.patch.label_outline import LabelOutline
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray, NoiseModel
from labdaemon.blur.settings import TARGET_SHAPE
from labdaemon.blur.sharp.template_residual import TemplateResidual
from labdaemon.blur.sharp.texture_map import PaperTextureMap
from labdaemon.blur.spectra import closed_form
from labdaemon.errors import UsageError
from labdaemon.flags import Flag


@dataclass(frozen=True, slots=True, eq=False)
class LensPsf:
    """The lens blur of each colour channel: an aperture's diffraction times a Gaussian.

    Attributes
    ----------
    channel
        (n,) channel numbers.
    variance_px2
        (n,) variance of the Gaussian part; may be slightly negative.
    width_px
        (n,) wavelength times f-number on the sensor, px; 0 for a lens that diffraction does not limit.
    offset_px
        (n, 2) each channel's centre against the target's (lateral chromatic aberration).
    """

    channel: NDArray[np.int64]
    variance_px2: FloatArray
    width_px: FloatArray
    offset_px: FloatArray

    @property
    def resolves_pixels(self) -> bool:
        """Whether its sharpest channel passes so much at the pixels' Nyquist frequency that finer ones are needed."""
        at = np.array([0.5])
        passed = [
            float(closed_form.gaussian_transfer(at**2, float(v))[0] * closed_form.diffraction_transfer(at, float(w))[0])
            for v, w in zip(self.variance_px2, self.width_px, strict=True)
        ]
        return max(passed) > 0.06

    def equivalent_variance_px2(self, frequency: float) -> float:
        """Variance of the Gaussian that passes as much at a frequency (cycles per pixel); mean of the channels, px²."""
        at = np.array([frequency])
        passed = [float(closed_form.diffraction_transfer(at, float(w))[0]) for w in self.width_px]
        diffraction = -np.log(np.maximum(passed, 1e-3)) / (2 * np.pi**2 * frequency**2)
        return float(np.mean(self.variance_px2 + diffraction))

    def channel_rows(self, channel: NDArray[np.int64]) -> NDArray[np.int64]:
        """Which row belongs to each of `channel`."""
        order = {int(number): row for row, number in enumerate(self.channel)}
        try:
            return np.array([order[int(number)] for number in channel])
        except KeyError as missing:
            raise UsageError(f"colour channel {missing} is not in the sharp frame; use frames of one camera") from None

    def transfer(self, grid: FrequencyGrid, channel: NDArray[np.int64]) -> ComplexArray:
        """(n, rows, columns) transfer function with the pixel and the channel's offset."""
        f2 = grid.fx**2 + grid.fy**2
        f = np.sqrt(f2)
        common = closed_form.pixel_transfer(grid.fx, grid.fy)
        result = np.empty((len(channel), *f2.shape), dtype=np.complex128)
        for place, row in enumerate(self.channel_rows(channel)):
            blur = closed_form.gaussian_transfer(f2, float(self.variance_px2[row])) * common
            if self.width_px[row] > 0:
                blur = blur * closed_form.diffraction_transfer(f, float(self.width_px[row]))
            shift = grid.fx * self.offset_px[row, 0] + grid.fy * self.offset_px[row, 1]
            result[place] = blur * np.exp(-2j * np.pi * shift)
        return result


class TargetShape(Protocol):
    """A target at rest, as spectra about its centre."""

    def spectra(self, grid: FrequencyGrid, channel: NDArray[np.int64]) -> tuple[ComplexArray, ComplexArray]:
        """Spectra of the darkness and their derivatives by the uncertain shape parameters.

        Returns
        -------
        spectrum, derivatives
            (n, rows, columns) and (k, n, rows, columns).
        """
        ...

    @property
    def prior_covariance(self) -> FloatArray:
        """(k, k) covariance of those shape parameters before the blurred frame is seen."""
        ...

    @property
    def half_size_px(self) -> tuple[float, float]:
        """Half width and half height of the target."""
        ...

    @property
    def moment_px2(self) -> FloatArray:
        """(2, 2) second central moment of its darkness over its total, blur and pixel included."""
        ...

    @property
    def oversampling(self) -> int:
        """Oversampling of the frequencies that it needs."""
        ...

    @property
    def psf_margin_px(self) -> int:
        """Room that its blur needs between it and its periodic images."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class EllipseShape:
    """A uniformly dark ellipse behind a lens.

    Attributes
    ----------
    q_px
        (3,) the matrix [[q0, q1], [q1, q2]] that maps the unit disc to the ellipse.
    lens
        Blur of each channel.
    shape_covariance
        (4, 4) covariance of q0, q1, q2 (px) and the blur's variance (px²).
    template_residual
        What the sharp image shows beyond the ellipse, if that is more than noise.
    """

    q_px: FloatArray
    lens: LensPsf
    shape_covariance: FloatArray
    template_residual: TemplateResidual | None = None

    def spectra(self, grid: FrequencyGrid, channel: NDArray[np.int64]) -> tuple[ComplexArray, ComplexArray]:
        """Closed form, and template residual; derivatives by q0, q1, q2 and the blur's variance.

        With a strong template residual the derivatives are by a small linear distortion (xx, yy, xy, yx: a label that
        tilts and turns) and the blur's variance.
        """
        lens = self.lens.transfer(grid, channel)
        dark, by_q = closed_form.ellipse_spectrum(grid.fx, grid.fy, self.q_px)
        spectrum = dark * lens
        by_blur = -2 * np.pi**2 * (grid.fx**2 + grid.fy**2) * spectrum
        if self.template_residual is None or not self.template_residual.is_strong:
            derivatives = np.concatenate((by_q[:, None] * lens, by_blur[None]))
            return spectrum if self.template_residual is None else spectrum + self.template_residual.spectrum(
                grid
            ), derivatives
        q = self.q_px
        by_linear = self.template_residual.affine_derivatives(grid)[:, None] + np.zeros_like(spectrum)
        # (1 + E) Q, made symmetric: what turns a circle does not change it.
        by_linear[0] += (q[0] * by_q[0] + q[1] * by_q[1] / 2) * lens
        by_linear[1] += (q[2] * by_q[2] + q[1] * by_q[1] / 2) * lens
        for index in (2, 3):
            by_linear[index] += ((q[0] + q[2]) / 4 * by_q[1] + q[1] / 2 * (by_q[0] + by_q[2])) * lens
        return spectrum + self.template_residual.spectrum(grid), np.concatenate((by_linear, by_blur[None]))

    @property
    def prior_covariance(self) -> FloatArray:
        """Covariance of the parameters that `spectra` differentiates by."""
        if self.template_residual is None or not self.template_residual.is_strong:
            return self.shape_covariance
        return np.diag([*[TARGET_SHAPE.distortion_sd**2] * 4, self.shape_covariance[3, 3]])

    @property
    def half_size_px(self) -> tuple[float, float]:
        """Half width and half height."""
        q0, q1, q2 = self.q_px
        return float(np.hypot(q0, q1)), float(np.hypot(q1, q2))

    @property
    def moment_px2(self) -> FloatArray:
        """QQᵀ/4 and the core of the blur (an Airy pattern's own second moment does not exist)."""
        q = np.array([[self.q_px[0], self.q_px[1]], [self.q_px[1], self.q_px[2]]])
        blur = float(np.mean(self.lens.variance_px2 + (0.45 * self.lens.width_px) ** 2)) + 1 / 12
        result: FloatArray = q @ q / 4 + blur * np.eye(2)
        return result

    @property
    def oversampling(self) -> int:
        """2 for a lens that is sharper than the pixels."""
        return 2 if self.lens.resolves_pixels else 1

    @property
    def psf_margin_px(self) -> int:
        """12 for a lens that diffraction limits: an Airy pattern's skirts fall slowly; 4 for others."""
        return 12 if float(np.max(self.lens.width_px)) > 1.0 else 4


@dataclass(frozen=True, slots=True, eq=False)
class SharpTarget:
    """A target at rest.

    Attributes
    ----------
    name
        The target's name.
    centre_px
        (2,) x and y in the frame.
    covariance_px2
        (2, 2) of the centre.
    form
        Its spectrum.
    contrast
        Per channel number, 1 − ink/white (1 for a texture, whose contrast is its own).
    noise
        The noise model in use; `noise_known` is False where it is only an estimate.
    paper_px
        Distance from the centre to the paper's edge.
    chi2
        Mean squared normalised residual of the sharp fit.
    flags
        `poor_fit` for a sharp frame that is itself blurred or not a dot, `saturated`, `not_found`.
    texture_map
        Paper texture around it, where it was mapped.
    outline
        Where its label ends; None where that is not known.
    """

    name: str
    centre_px: FloatArray
    covariance_px2: FloatArray
    form: TargetShape
    contrast: dict[int, float]
    noise: NoiseModel
    noise_known: bool = True
    paper_px: float = float("inf")
    chi2: float = 1.0
    flags: frozenset[Flag] = field(default_factory=frozenset)
    texture_map: PaperTextureMap | None = None
    outline: LabelOutline | None = None

    def with_scale_uncertainty(self, place_px: FloatArray) -> SharpTarget:
        """The target where its mean position is another than at rest: its size is known less well there.

        What moved sideways may have come nearer or gone away by as much, and looks larger or smaller by that part of
        its distance; a lens is `TARGET_SHAPE.min_focal_px` long or more.
        """
        part = float(np.hypot(*(place_px - self.centre_px))) / TARGET_SHAPE.min_focal_px
        if not isinstance(self.form, EllipseShape) or not part > 0:
            return self
        size = np.append(self.form.q_px, 0.0) * part
        covariance = self.form.shape_covariance + np.outer(size, size)
        return replace(self, form=replace(self.form, shape_covariance=covariance))

    @property
    def usable(self) -> bool:
        """Whether later fits can rest on it."""
        return Flag.NOT_FOUND not in self.flags and bool(np.all(np.isfinite(self.centre_px)))
