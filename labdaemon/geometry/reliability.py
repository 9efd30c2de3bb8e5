"""Gross errors in a bundle adjustment: found by data snooping, named, and left out one after the other.

Each observation's residual (both coordinates together) and each control point's survey residual (all three) is tested
against its own standard deviation after the adjustment (Baarda 1968). The smallest error that a test would find shows
how far the geometry checks itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labdaemon.geometry.bundle import Adjustment, adjust_network
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.network import Network
from labdaemon.geometry.settings import SNOOPING


@dataclass(frozen=True, slots=True)
class GrossError:
    """An observation that the others contradict.

    Attributes
    ----------
    kind
        ``observation`` (misread or misidentified in one image) or ``survey`` (mis-surveyed control).
    point, image
        Name of the point; index of the image, -1 for a survey.
    test
        Residual over its standard deviation.
    size
        Estimated size of the error: px for a observation, the points' unit for a survey.
    """

    kind: Literal["observation", "survey"]
    point: str
    image: int
    test: float
    size: float


@dataclass(frozen=True, slots=True, eq=False)
class ObservationTests:
    """Test values of all observations of an adjustment.

    Attributes
    ----------
    observations, redundancy
        (n,) squared normalised residuals (two degrees of freedom), and the share of each observation that is checked by
        the others, 0..1.
    survey
        (p,) the same of surveyed points (as many degrees of freedom as coordinates known), 0 where not surveyed.
    detectable_px
        (n,) smallest error of a observation that is found with a power of 80 %, px; inf where nothing checks it.
    """

    observations: FloatArray
    redundancy: FloatArray
    survey: FloatArray
    survey_error: FloatArray
    detectable_px: FloatArray


def compute_observation_tests(adjustment: Adjustment) -> ObservationTests:
    """Test every observation of an adjustment against its stated standard deviation."""
    network = adjustment.network
    variance = 1.0 / network.weights
    eye = np.eye(2)
    left = variance[:, None, None] * eye - adjustment.fitted_cofactor()
    redundancy = np.clip(np.trace(left, axis1=1, axis2=2) / (2.0 * variance), 0.0, 1.0)
    checked = redundancy > SNOOPING.min_redundancy
    observations, detectable = np.zeros(len(redundancy)), np.full(len(redundancy), np.inf)
    safe = left[checked] + 1e-9 * variance[checked, None, None] * eye
    residuals = adjustment.residuals_px[checked]
    observations[checked] = np.einsum("ni,ni->n", residuals, np.linalg.solve(safe, residuals[..., None])[..., 0])
    # Non-centrality of a test of one direction at 0.1 % and 80 %: (3.29 + 0.84)².
    detectable[checked] = SNOOPING.noncentrality * np.sqrt(variance[checked] / redundancy[checked])
    survey, survey_error = _compute_survey_tests(adjustment)
    return ObservationTests(observations, redundancy, survey, survey_error, detectable)


def _compute_survey_tests(adjustment: Adjustment) -> tuple[FloatArray, FloatArray]:
    """(p,) squared normalised survey residuals, and (p,) estimated sizes of the errors behind them."""
    network = adjustment.network
    sd = network.survey_sd
    known = (sd > 0) & np.isfinite(sd)
    tests, sizes = np.zeros(len(sd)), np.zeros(len(sd))
    if not known.any():
        return tests, sizes
    cofactor = adjustment.point_covariance(scaled=False)
    for point in np.flatnonzero(known.any(axis=1)).tolist():
        axes = np.flatnonzero(known[point])
        variance = np.diag(sd[point, axes] ** 2)
        left = variance - cofactor[point][np.ix_(axes, axes)]
        if np.trace(left) < SNOOPING.min_redundancy * np.trace(variance):
            continue
        residual = adjustment.survey_residuals[point, axes]
        solved = np.linalg.pinv(left, rcond=1e-6, hermitian=True) @ residual
        tests[point] = float(residual @ solved)
        sizes[point] = float(np.linalg.norm(variance @ solved))
    return tests, sizes


def find_gross_error(adjustment: Adjustment, names: Sequence[str]) -> GrossError | None:
    """Observation that stands out most, None when all agree.

    Residuals larger than stated throughout (sigma0 above 1) raise the limit: they are a matter of weights.
    """
    network, tests = adjustment.network, compute_observation_tests(adjustment)
    sd = network.survey_sd
    freedom = ((sd > 0) & np.isfinite(sd)).sum(axis=1)
    median_ratio = float(np.median(tests.observations)) / float(chi2.median(2)) if len(tests.observations) else 1.0
    scale = max(1.0, median_ratio)
    count = len(tests.observations) + int((freedom > 0).sum())
    limit = np.log(SNOOPING.significance / count)
    observation_log_p = chi2.logsf(tests.observations / scale, 2)
    survey_log_p = np.where(freedom > 0, chi2.logsf(tests.survey / scale, np.maximum(freedom, 1)), 0.0)
    first = int(np.argmin(observation_log_p)) if len(observation_log_p) else -1
    second = int(np.argmin(survey_log_p)) if len(survey_log_p) else -1
    min_observation_log_p = observation_log_p[first] if first >= 0 else 0.0
    min_survey_log_p = survey_log_p[second] if second >= 0 else 0.0
    if min(min_observation_log_p, min_survey_log_p) > limit:
        return None
    if min_survey_log_p <= min_observation_log_p:
        size = float(tests.survey_error[second])
        return GrossError("survey", names[second], -1, float(np.sqrt(tests.survey[second])), size)
    size = float(
        np.linalg.norm(adjustment.residuals_px[first]) / max(tests.redundancy[first], SNOOPING.min_redundancy_for_size)
    )
    return GrossError(
        "observation",
        names[network.point[first]],
        int(network.image[first]),
        float(np.sqrt(tests.observations[first])),
        size,
    )


def adjust_without_gross_errors(
    network: Network, names: Sequence[str], *, max_errors: int = 50
) -> tuple[Adjustment, tuple[str, ...], list[GrossError]]:
    """Adjust, leave out the worst gross error, and again until all observations agree.

    Parameters
    ----------
    network, names
        Observations, and (p,) names of the points.
    max_errors
        Give up removing after so many; a network that bad needs eyes.

    Returns
    -------
    tuple
        The adjustment, the names of the points left in it (a free point seen by fewer than two images goes), and
        the errors in the order found.
    """
    found: list[GrossError] = []
    adjustment = adjust_network(network, names=names)
    for _ in range(max_errors):
        worst = find_gross_error(adjustment, names)
        if worst is None:
            break
        found.append(worst)
        index = list(names).index(worst.point)
        # Control keeps its surveyed values as the values to be observed, so restart from the original coordinates.
        adjusted = adjustment.network
        points = np.where(np.isfinite(network.survey_sd), network.points, adjusted.points)
        start = replace(network, lenses=adjusted.lenses, poses=adjusted.poses, points=points)
        if worst.kind == "survey":
            sd = network.survey_sd.copy()
            sd[index] = np.inf
            points[index] = adjusted.points[index]
            network, names = select_observations(replace(start, control_sd=sd, points=points), names)
        else:
            keep = ~((network.point == index) & (network.image == worst.image))
            network, names = select_observations(start, names, keep)
        adjustment = adjust_network(network, names=names)
    return adjustment, tuple(names), found


def select_observations(
    network: Network, names: Sequence[str], keep: NDArray[np.bool_] | None = None
) -> tuple[Network, tuple[str, ...]]:
    """Network with only the observations to keep, and only points whose place these or their survey fix.

    Parameters
    ----------
    network, names
        Observations, and (p,) names of the points.
    keep
        (n,) bool; all by default.
    """
    keep = np.ones(len(network.point), dtype=np.bool_) if keep is None else keep
    rays = np.bincount(network.point[keep], minlength=len(network.points))
    known = np.isfinite(network.survey_sd).all(axis=1)
    in_bar = np.zeros(len(network.points), dtype=np.bool_)
    for bar in network.bars:
        in_bar[[bar.first, bar.second]] = True
    stay = (rays >= 2) | (known & ((rays > 0) | in_bar))
    place = np.cumsum(stay) - 1
    keep = keep & stay[network.point]
    sd = np.broadcast_to(np.asarray(network.sd_px, dtype=float), (len(network.point),))
    bars = tuple(
        replace(bar, first=int(place[bar.first]), second=int(place[bar.second]))
        for bar in network.bars
        if stay[bar.first] and stay[bar.second]
    )
    reduced = replace(
        network,
        points=network.points[stay],
        image=network.image[keep],
        point=place[network.point[keep]],
        image_px=network.image_px[keep],
        sd_px=sd[keep],
        control_sd=network.survey_sd[stay],
        bars=bars,
    )
    return reduced, tuple(name for name, stays in zip(names, stay, strict=True) if stays)
