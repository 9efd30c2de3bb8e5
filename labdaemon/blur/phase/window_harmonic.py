"""A third harmonic without a gauge, through known windows: what several targets show of it together.

Of d = v·(sin θ + c sin 3θ + s cos 3θ), θ = ωt + ψ, whole cycles show c alone (``third_harmonic``). Through windows of
part cycles at known phases s acts as well: it skews the blur as a change of ψ does. A fit without a harmonic is up to
0.4 % off in amplitude for each per cent of c, and 0.7 to 1.4° in phase for each per cent of s. One target hardly
separates s from ψ, and several do but roughly; a harmonic whose c is small hardly is one of large s, so that s is
expected to be of the size of c. At each in-phase solution one look at the images gives the equations of c and s, with
everything else free, a minor axis included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.phase.orbits import minor_axis_transfer
from labdaemon.blur.phase.third_harmonic import LARGEST, LEAST, SHOWN, mean_and_scatter
from labdaemon.blur.phase.window_evidence import LARGEST_PX, LEAST_PX, NO_EVIDENCE, STRAIGHT
from labdaemon.blur.settings import PHASE
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.fit_problem import TransferFunction
from labdaemon.blur.smear.frame_set import FrameSet, window_in_phase_transfer
from labdaemon.blur.smear.gls_frames import frame_products
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.waveform import quadrature_transfer
from labdaemon.half_turn import major_phase_rad
from labdaemon.least_squares import scaled_inverse

FREED = 4
"""Parameters beyond those of an in-phase motion: β, β², c, s."""
ITERATIONS = 8
"""Of the fit that the equations are taken at; it begins at the measurement."""


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicEvidence:
    """Equations of c and s of one target.

    Attributes
    ----------
    target
        Its name.
    information, score
        (2, 2) and (2,), everything else eliminated, over the mean squared residual.
    """

    target: str
    information: FloatArray
    score: FloatArray

    @property
    def value(self) -> FloatArray:
        """(2,) c and s."""
        return scaled_inverse(self.information) @ self.score

    @property
    def sd(self) -> FloatArray:
        """(2,) their standard deviations."""
        return np.sqrt(np.diag(scaled_inverse(self.information)))

    @property
    def gain(self) -> float:
        """By how many squared standard deviations they explain the images better."""
        return float(self.score @ self.value)


@dataclass(frozen=True, slots=True)
class WindowHarmonic:
    """Third harmonic of the targets of a group of frames, over their fundamental.

    Attributes
    ----------
    own
        By name of the target: values and standard deviations of c and s.
    mean, scatter
        (c, s) of all targets; the scatter is the standard deviation of another target's about the mean.
    """

    own: dict[str, tuple[tuple[float, float], tuple[float, float]]]
    mean: tuple[float, float]
    scatter: tuple[float, float]

    def of(self, target: str) -> MotionHarmonics:
        """One target's harmonics: its own, drawn to the mean by how well each is known."""
        mean, sd = np.array(self.mean), np.array(self.scatter)
        if target in self.own:
            value, own_sd = (np.array(one) for one in self.own[target])
            weight = own_sd**-2 / (own_sd**-2 + sd**-2)
            mean, sd = mean + weight * (value - mean), (own_sd**-2 + sd**-2) ** -0.5
        return MotionHarmonics(
            (0.0, float(mean[0])), (0.0, float(mean[1])), (0.0, float(sd[0])), sd_sine=(0.0, float(sd[1]))
        )


def says_harmonic(found: Measurement) -> bool:
    """Whether a target has a straight path of known phase, long enough to show the waveform."""
    if not found.phased or found.axes is not None or found.alternatives or found.flags & NO_EVIDENCE:
        return False
    if not np.isfinite([*found.a_px, *found.b_px]).all():
        return False
    major, minor = np.linalg.svd(np.stack((found.a_px, found.b_px)), compute_uv=False)
    return bool(LEAST_PX < major < LARGEST_PX and minor < STRAIGHT * major)


def harmonic_evidence(frame_set: FrameSet, found: Measurement) -> HarmonicEvidence | None:
    """What a target's frames say of its third harmonic; None where they cannot be asked.

    Parameters
    ----------
    frame_set, found
        The target in its frames, and its motion as a sinusoid.
    """
    if not frame_set.sharp.noise_known or isinstance(frame_set.sharp.form, TexturedPatch):
        return None
    phase = major_phase_rad(found.a_px, found.b_px)
    vector = np.cos(phase) * found.a_px + np.sin(phase) * found.b_px
    start = frame_set.initial_parameters(found.a_px, found.b_px, np.append(vector, phase))
    model = frame_set.forward_model(window_in_phase_transfer, 3.0 + 1.3 * float(np.hypot(*vector)))
    prior = frame_set.prior(3)
    solution = solve(frame_set.planes, frame_set.weights, model, start, prior, max_iterations=ITERATIONS)
    if not 0.0 <= solution.covariance[-1, -1] < PHASE.linear_phase_sd_rad**2:
        return None
    k = len(solution.p)
    extended = replace(solution, p=np.concatenate((solution.p, np.zeros(FREED))))
    normal, score = np.zeros((k + FREED, k + FREED)), np.zeros(k + FREED)
    for own, products, _ in frame_products(frame_set, extended, _harmonic_transfer):
        normal[np.ix_(own, own)] += products[:-1, :-1]
        score[own] += products[:-1, -1]
    normal[:k, :k] += prior.precision
    score[:k] -= prior.precision @ (solution.p - prior.mean)
    k += FREED - 2
    cross = normal[k:, :k] @ scaled_inverse(normal[:k, :k])
    scale = max(solution.chi2, 1.0)
    return HarmonicEvidence(
        frame_set.sharp.name, (normal[k:, k:] - cross @ normal[:k, k:]) / scale, (score[k:] - cross @ score[:k]) / scale
    )


def window_harmonic(evidence: Sequence[HarmonicEvidence]) -> WindowHarmonic | None:
    """The harmonic that several targets show; None where they show none."""
    if not evidence:
        return None
    together = np.sum([one.score for one in evidence], axis=0)
    total = np.sum([one.information for one in evidence], axis=0)
    common = float(together @ scaled_inverse(total) @ together)
    separate = sum(one.gain for one in evidence)
    if max(common - 2, separate - 2 * len(evidence)) < SHOWN:
        return None
    values, sds = np.array([one.value for one in evidence]), np.array([one.sd for one in evidence])
    (c, c_scatter), (s, s_scatter) = (mean_and_scatter(values[:, part], sds[:, part]) for part in (0, 1))
    expected = c**2 + c_scatter**2
    share = expected / (expected + s_scatter**2)
    s, s_scatter = share * s, float(np.sqrt(share)) * s_scatter
    if np.hypot(c, c_scatter) < LEAST or np.hypot(c, s) > LARGEST:
        return None
    own = {
        one.target: ((float(value[0]), float(value[1])), (float(sd[0]), float(sd[1])))
        for one, value, sd in zip(evidence, values, sds, strict=True)
    }
    return WindowHarmonic(own, (c, s), (c_scatter, s_scatter))


def _harmonic_transfer(basis: FloatArray, weight: FloatArray) -> TransferFunction:
    """As `minor_axis_transfer`, with derivatives by c and s at no harmonic."""
    minor = minor_axis_transfer(basis, weight)

    def motion(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        transfer, slopes = minor(fx, fy, p[:5])
        sine = np.cos(p[2]) * basis[0] + np.sin(p[2]) * basis[1]
        cosine = np.cos(p[2]) * basis[1] - np.sin(p[2]) * basis[0]
        along = -2j * np.pi * (p[0] * fx + p[1] * fy)
        thirds = (3 * sine - 4 * sine**3, 4 * cosine**3 - 3 * cosine)
        by_harmonic = [along * quadrature_transfer(fx, fy, p[:2], sine[None], weight * third)[0] for third in thirds]
        return np.asarray(transfer, np.complex128), np.concatenate((slopes, by_harmonic))

    return motion
