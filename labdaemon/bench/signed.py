"""Signed motions from coded light and from known windows: phase, amplitude and twins, compared with the bound."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labdaemon.bench.bound import LENS_SIGMA_PX, PX_PER_MM
from labdaemon.bench.dots import DIFFRACTION_PX, OWN_LENS_SIGMA_PX, TEXTURE_MM
from labdaemon.bench.pairs import read_truth
from labdaemon.bench.programme import run_cases
from labdaemon.bench.signed_cases import SignedCase, signed_cases
from labdaemon.bench.signed_error import signed_error
from labdaemon.bench.simulator import folder_maker
from labdaemon.blur import DotImage, ExposureWindow, FloatArray, Measurement, NoiseModel, predict_sd
from labdaemon.flags import Flag
from labdaemon.geometry import ObjectMotion
from labdaemon.processing import WorkerPool, jobs, join_motions, measure_in_folder, open_folder, prepare_sharp

MEAN_GREY = 0.825
"""Mean over the pixels of an RGGB mosaic of the colours' sensitivities 0.58, 1 and 0.72."""

PRNU = 0.004
"""Sensitivities of the simulated pixels scatter by this: noise that no exposure removes."""

GAUSSIAN_SIGMA_PX = 0.8
"""Of the simulated lens without diffraction."""

TASK_LIMIT_S = 3600.0
"""A task renders and measures a whole case, on a machine that may be busy with other work."""

TWIN_FRACTION = 0.35
"""Error of the signed vectors, in parts of the motion, from which they are another motion's."""


@dataclass(frozen=True, slots=True, eq=False)
class SignedComparison:
    """One target's signed motion, as it was and as it was measured.

    Attributes
    ----------
    true_mm, true_px
        Length of (a, b) in space, and in the image in which it is longest.
    vector_error_mm
        Length of the error of (a, b).
    amplitude_error_mm, phase_error_deg
        Of the length, and of the common phase.
    pulls
        Errors over stated standard deviations: of amplitude and phase for one camera, else of each component.
    sd_phase_deg, bound_phase_deg
        Stated standard deviation of the phase and its Cramér–Rao bound; NaN for several cameras.
    bound_mm
        Cramér–Rao bound of the signed vectors, root mean square.
    flags
        As reported.
    """

    true_mm: float
    true_px: float
    vector_error_mm: float
    amplitude_error_mm: float
    phase_error_deg: float
    pulls: tuple[float, ...]
    sd_phase_deg: float
    bound_phase_deg: float
    bound_mm: float
    flags: frozenset[str]

    @property
    def unflagged(self) -> bool:
        """Whether it is reported without a flag."""
        return not self.flags

    @property
    def is_wrong(self) -> bool:
        """Whether another motion was taken, a twin for example."""
        return self.vector_error_mm > TWIN_FRACTION * self.true_mm


@dataclass(frozen=True, slots=True, eq=False)
class SignedResult:
    """A case, measured."""

    case: SignedCase
    targets: list[SignedComparison]


def run_signed(
    seeds: Sequence[int],
    *,
    quick: bool = False,
    only: frozenset[str] | None = None,
    workers: int = 0,
    report: Callable[[str], None] = lambda _: None,
) -> list[SignedResult]:
    """Render and measure all cases.

    Parameters
    ----------
    seeds
        Of the simulator; each renders the whole programme anew.
    quick
        One capture a case, and fewer targets.
    only
        Keys of the cases to run; None for all.
    workers
        Processes, 0 for one a core.
    report
        Called at each case's completion.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    folder_maker()
    results = [SignedResult(case, []) for case in signed_cases(quick) if only is None or case.key in only]
    with WorkerPool(workers, deadline_s=TASK_LIMIT_S) as pool, tempfile.TemporaryDirectory() as root:
        for result, compared in run_cases(pool, Path(root), seeds, results, compare_case, report):
            result.targets.extend(compared)
    return results


def compare_case(case: SignedCase, seed: int, folder: Path) -> list[SignedComparison]:
    """Render one case and measure it; a worker's task."""
    folder_maker()(folder, **case.folder_options(seed))
    opened, sharp, truth = open_folder(folder), prepare_sharp(folder), read_truth(folder)
    compared: list[SignedComparison] = []
    for job in jobs(opened):
        frames = [measure_in_folder(opened, sharp, job.captures, camera.name) for camera in sharp.cameras]
        rows = [row for row in truth if row["capture"] == job.name]
        views = {camera.name: camera.view for camera in sharp.cameras}
        places = np.array([[row["x_mm"], row["y_mm"], row["z_mm"]] for row in rows])
        motions = [np.array([[row[f"{kind}{axis}"] for axis in "xyz"] for kind in "ab"]) for row in rows]
        images = {name: view.project_with_jacobians(places)[1] for name, view in views.items()}
        nearest = {
            target: int(np.argmin(np.linalg.norm(places - place, axis=1)))
            for target, place in zip(sharp.targets, sharp.places_mm, strict=True)
        }
        if len(sharp.cameras) == 1:
            view = sharp.cameras[0].name
            windows = [opened.capture(name).about.window(view) for name in job.captures]
            known = [window for window in windows if window is not None]
            for one in frames[0].measurements:
                index = nearest[one.target]
                compared.append(_in_image(case, one, motions[index], images[view][index], known))
            continue
        for target, (motion, flags) in join_motions(sharp, frames).items():
            index = nearest[target]
            sizes = [float(np.linalg.norm(jacobians[index] @ motions[index].T)) for jacobians in images.values()]
            compared.append(_in_space(motion, frozenset(flag.value for flag in flags), motions[index], max(sizes)))
    return compared


def _in_image(
    case: SignedCase, one: Measurement, motion_mm: FloatArray, jacobian: FloatArray, windows: list[ExposureWindow]
) -> SignedComparison:
    """One camera: amplitude and phase in the image, scaled to millimetres."""
    true = (jacobian @ motion_mm.T).T.reshape(4)
    size_px, size_mm = float(np.linalg.norm(true)), float(np.linalg.norm(motion_mm))
    scale = size_mm / size_px
    error = signed_error(one, true)
    bound = _bound(case, true, windows)
    return SignedComparison(
        size_mm,
        size_px,
        scale * error.vector_px,
        scale * error.amplitude_px,
        float(np.degrees(error.phase_rad)),
        (error.amplitude_pull, error.phase_pull),
        float(np.degrees(error.sd_phase_rad)),
        float(np.degrees(bound.phase_rad)),
        scale * float(np.hypot(bound.amplitude_px, size_px * np.hypot(bound.phase_rad, bound.direction_rad))),
        frozenset(flag.value for flag in one.flags),
    )


def _bound(case: SignedCase, true: FloatArray, windows: list[ExposureWindow]) -> Any:
    a, b = true[:2], true[2:]
    direction = float(np.arctan2(*(a if np.linalg.norm(a) > np.linalg.norm(b) else b)[::-1]))
    along = np.array([np.cos(direction), np.sin(direction)])
    size, phase = float(np.linalg.norm(true)), float(np.arctan2(b @ along, a @ along))
    white = MEAN_GREY * case.white_dn
    # Fixed pattern noise acts like photons: a larger variance for each count, at the brightness of this frame.
    gain = 1 / 8.5 + PRNU**2 * white * case.light_fraction
    is_gaussian = bool(case.options.get("gaussian_optics"))
    lens = GAUSSIAN_SIGMA_PX if is_gaussian else LENS_SIGMA_PX
    noise = NoiseModel(7.0 / 8.5, gain, 0.004, TEXTURE_MM * PX_PER_MM / math.sqrt(2.0)).seen_through(lens)
    dot = DotImage(
        0.5 * case.diameter_mm * PX_PER_MM,
        lens if is_gaussian else OWN_LENS_SIGMA_PX,
        white * (1 + case.ambient),
        0.05,
        noise,
        diffraction_px=0.0 if is_gaussian else DIFFRACTION_PX,
    )
    return predict_sd(windows, size, phase, dot, direction_rad=direction)


def _in_space(motion: ObjectMotion, flags: frozenset[str], true_mm: FloatArray, true_px: float) -> SignedComparison:
    """Several cameras: signed vectors in space."""
    error = np.stack((motion.a_mm, motion.b_mm)) - true_mm
    sd = np.sqrt(np.diag(motion.covariance_mm2)[3:])
    overlap = np.vdot(true_mm[0] + 1j * true_mm[1], motion.a_mm + 1j * motion.b_mm)
    found = float(np.hypot(np.linalg.norm(motion.a_mm), np.linalg.norm(motion.b_mm)))
    size, nan = float(np.linalg.norm(true_mm)), float("nan")
    missing = frozenset({Flag.NOT_FOUND.value}) if not np.isfinite(found) else frozenset()
    return SignedComparison(
        size,
        true_px,
        float(np.linalg.norm(error)),
        found - size,
        float(np.degrees(np.angle(overlap))),
        tuple(float(one) for one in error.reshape(6) / sd),
        nan,
        nan,
        nan,
        flags | missing,
    )
