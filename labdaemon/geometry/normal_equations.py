"""Normal equations of a bundle adjustment with the points eliminated (Schur complement).

Unknowns come in two kinds: *camera* unknowns (interior, exterior) that many observations share, and points, each of
which couples only with the cameras that see it. The points' part V of the normal matrix is therefore 3 × 3 blocks, and

    S = U − W V⁻¹ Wᵀ

is all that is ever inverted. Inner constraints and distances between points join the camera unknowns as multipliers
with rows of their own in W, so that V keeps its blocks: for a distance of variance σ² the multiplier's diagonal is
−σ², for an inner constraint 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.network import IntArray, Network
from labdaemon.geometry.oriented_camera import rotation_from_vector, skew


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedNetwork:
    """An adjustment linearised at its current values.

    Attributes
    ----------
    residuals
        (n, 2) of the observations, px.
    by_camera
        (2 n, k) sparse derivative by the camera unknowns: free interior parameters lens by lens, then six exterior
        ones an image.
    by_point
        (n, 2, 3) derivative by the observed point; zero for coordinates held fixed.
    survey
        (p, 3) surveyed minus current coordinates, 0 where nothing is known.
    survey_weights
        (p, 3) 1/variance of the surveyed coordinates, 0 where free or fixed.
    extra, extra_diagonal, extra_misclosure
        (q, 3 p) sparse rows of the constraints, (q,) minus their variances, (q,) what they lack.
    """

    residuals: FloatArray
    by_camera: sparse.csr_matrix
    by_point: FloatArray
    survey: FloatArray
    survey_weights: FloatArray
    extra: sparse.csr_matrix
    extra_diagonal: FloatArray
    extra_misclosure: FloatArray

    def cost(self, network: Network) -> float:
        """Weighted sum of squared residuals, of survey and distances too; inf when a point cannot be seen."""
        value = float(network.weights @ np.sum(self.residuals**2, axis=1))
        value += float(np.sum(self.survey_weights * self.survey**2))
        bars = self.extra_diagonal < 0
        value += float(np.sum(self.extra_misclosure[bars] ** 2 / -self.extra_diagonal[bars]))
        return value if np.isfinite(value) else float("inf")


def linearise(network: Network, surveyed: FloatArray) -> LinearisedNetwork:
    """Residuals and derivatives at the network's current values; `surveyed` (p, 3) are the control coordinates."""
    count, images = len(network.image), len(network.poses)
    rotations = np.stack([pose.rotation for pose in network.poses])[network.image]
    centres = np.stack([pose.position for pose in network.poses])[network.image]
    local = np.einsum("nij,nj->ni", rotations, network.points[network.point] - centres)
    depth = np.where(local[:, 2] > 0, local[:, 2], np.nan)
    slopes = local[:, :2] / depth[:, None]
    residuals, by_slope = np.empty((count, 2)), np.empty((count, 2, 2))
    columns = network.interior_columns
    offsets = np.cumsum([0, *(len(c) for c in columns)])
    blocks: list[tuple[FloatArray, IntArray, IntArray]] = []
    observation_lens = network.lens_of[network.image]
    for index, lens in enumerate(network.lenses):
        mine = np.flatnonzero(observation_lens == index)
        residuals[mine], by_slope[mine], by_interior = lens.linearise(network.image_px[mine], slopes[mine])
        if len(columns[index]):
            places = np.broadcast_to(np.arange(offsets[index], offsets[index + 1]), (len(mine), len(columns[index])))
            blocks.append((by_interior[:, :, columns[index]], mine, places))
    slope_by_local = np.zeros((count, 2, 3))
    slope_by_local[:, 0, 0] = slope_by_local[:, 1, 1] = 1.0 / depth
    slope_by_local[:, :, 2] = -slopes / depth[:, None]
    by_local = by_slope @ slope_by_local
    by_point = by_local @ rotations
    by_exterior = np.concatenate([-by_local @ skew(local), -by_point], axis=2)
    blocks.append((by_exterior, np.arange(count), offsets[-1] + 6 * network.image[:, None] + np.arange(6)))
    by_camera = _assemble_blocks(blocks, (2 * count, int(offsets[-1]) + 6 * images))
    sd = network.survey_sd
    with np.errstate(divide="ignore"):
        weights = np.where((sd > 0) & np.isfinite(sd), sd**-2.0, 0.0)
    survey = np.where(np.isfinite(sd), surveyed - network.points, 0.0)
    extra, diagonal, misclosure = _constraint_rows(network)
    return LinearisedNetwork(
        residuals,
        by_camera,
        by_point * (sd > 0)[network.point][:, None, :],
        survey,
        weights,
        extra,
        diagonal,
        misclosure,
    )


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Reduced normal equations.

    Attributes
    ----------
    inverse_v
        (p, 3, 3) V⁻¹; zero for coordinates held fixed.
    transfer
        (3 p, k + q) sparse V⁻¹ W̃ᵀ.
    reduced
        (k + q, k + q) S.
    right_camera, right_point
        Right-hand sides (k + q,) of S and (p, 3) of V.
    """

    inverse_v: FloatArray
    transfer: sparse.csr_matrix
    reduced: FloatArray
    right_camera: FloatArray
    right_point: FloatArray

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Change of the camera unknowns and multipliers (k + q,) and of the points (p, 3)."""
        scale = _diagonal_scale(self.reduced)
        cameras = scale * np.linalg.solve(self.reduced * np.outer(scale, scale), scale * self.right_camera)
        points = np.einsum("pij,pj->pi", self.inverse_v, self.right_point)
        return cameras, points - (self.transfer @ cameras).reshape(points.shape)

    def cofactor(self) -> FloatArray:
        """(k + q, k + q) inverse of S; its first k rows are the camera unknowns' covariance for unit weight.

        Raises
        ------
        DataError
            The unknowns are not determined.
        """
        scale = _diagonal_scale(self.reduced)
        scaled = self.reduced * np.outer(scale, scale)
        if np.linalg.cond(scaled) > 1e15:
            raise DataError(
                "the images do not determine all unknowns: fix some interior parameters, add images (some rolled "
                "by 90°), control or scale bars"
            )
        inverse: FloatArray = np.linalg.inv(scaled) * np.outer(scale, scale)
        return inverse


def form_normal(network: Network, linear: LinearisedNetwork, damping: float = 0.0) -> NormalEquations:
    """Normal equations of the linearised network, with Levenberg–Marquardt damping relative to the diagonal."""
    count, points = len(network.image), len(network.points)
    weights = network.weights
    weighted = weights[:, None, None] * linear.by_point
    v = np.zeros((points, 3, 3))
    np.add.at(v, network.point, np.einsum("nki,nkj->nij", weighted, linear.by_point))
    right_point = np.zeros((points, 3))
    np.add.at(right_point, network.point, np.einsum("nki,nk->ni", weighted, linear.residuals))
    right_point += linear.survey_weights * linear.survey
    diagonal = np.arange(3)
    v[:, diagonal, diagonal] += linear.survey_weights
    v[:, diagonal, diagonal] *= 1.0 + damping
    fixed = network.survey_sd == 0
    v[:, diagonal, diagonal] += fixed
    try:
        inverse_v = np.linalg.inv(v) * ~(fixed[:, :, None] | fixed[:, None, :])
    except np.linalg.LinAlgError as exc:
        raise DataError("some points are seen along parallel rays only, so that their depth is not fixed") from exc
    rows = np.repeat(np.arange(2 * count), 3)
    places = np.repeat(3 * network.point[:, None] + np.arange(3), 2, axis=0).ravel()
    weighted_points = sparse.csr_matrix((weighted.ravel(), (rows, places)), shape=(2 * count, 3 * points))
    w = sparse.vstack([(weighted_points.T @ linear.by_camera).T, linear.extra]).tocsr()
    block_inverse = sparse.bsr_matrix(
        (inverse_v, np.arange(points), np.arange(points + 1)), shape=(3 * points, 3 * points)
    )
    transfer = (block_inverse @ w.T).tocsr()
    doubled = np.repeat(weights, 2)
    u = (linear.by_camera.T @ sparse.diags(doubled) @ linear.by_camera).toarray()
    u[np.diag_indices_from(u)] *= 1.0 + damping
    size, cameras = w.shape[0], u.shape[0]
    reduced = np.zeros((size, size))
    reduced[:cameras, :cameras] = u
    reduced[np.arange(cameras, size), np.arange(cameras, size)] = linear.extra_diagonal
    reduced -= (w @ transfer).toarray()
    right_camera = np.concatenate([linear.by_camera.T @ (doubled * linear.residuals.ravel()), linear.extra_misclosure])
    right_camera = right_camera - transfer.T @ right_point.ravel()
    return NormalEquations(inverse_v, transfer, 0.5 * (reduced + reduced.T), right_camera, right_point)


def apply_change(network: Network, cameras: FloatArray, points: FloatArray) -> Network:
    """Network after a change of its camera unknowns (multipliers behind them are ignored) and points (p, 3)."""
    lenses, offset = list(network.lenses), 0
    for index, columns in enumerate(network.interior_columns):
        parameters = lenses[index].parameters.copy()
        parameters[columns] += cameras[offset : offset + len(columns)]
        lenses[index] = lenses[index].with_parameters(parameters)
        offset += len(columns)
    changes = cameras[offset : offset + 6 * len(network.poses)].reshape(-1, 6)
    poses = tuple(
        replace(pose, rotation=rotation_from_vector(change[:3]) @ pose.rotation, position=pose.position + change[3:])
        for pose, change in zip(network.poses, changes, strict=True)
    )
    return replace(network, lenses=tuple(lenses), poses=poses, points=network.points + points)


def _constraint_rows(network: Network) -> tuple[sparse.csr_matrix, FloatArray, FloatArray]:
    """Rows of distances and inner constraints by the points, their diagonals and misclosures."""
    size = network.points.size
    rows: list[FloatArray] = []
    diagonal: list[float] = []
    misclosure: list[float] = []
    free = network.survey_sd > 0
    for bar in network.bars:
        across = network.points[bar.first] - network.points[bar.second]
        length = float(np.linalg.norm(across))
        row = np.zeros((len(network.points), 3))
        row[bar.first], row[bar.second] = across / length, -across / length
        rows.append((row * free).ravel())
        diagonal.append(-(bar.sd**2))
        misclosure.append(bar.length - length)
    if network.datum:
        centred = network.points - network.points.mean(axis=0)
        centred = centred / float(np.abs(centred).max())
        shifts = [np.tile(axis, (len(centred), 1)) for axis in np.eye(3)]
        turns = [np.cross(axis, centred) for axis in np.eye(3)]
        inner = [*shifts, *turns] if network.bars else [*shifts, *turns, centred]
        rows += [motion.ravel() for motion in inner]
        diagonal += [0.0] * len(inner)
        misclosure += [0.0] * len(inner)
    matrix = sparse.csr_matrix(np.array(rows).reshape(len(rows), size))
    return matrix, np.array(diagonal), np.array(misclosure)


def _assemble_blocks(blocks: list[tuple[FloatArray, IntArray, IntArray]], shape: tuple[int, int]) -> sparse.csr_matrix:
    """Sparse matrix of (n, 2, m) blocks at observations (n,) and columns (n, m)."""
    values, rows, columns = [], [], []
    for block, observations, places in blocks:
        values.append(block.ravel())
        width = block.shape[2]
        rows.append(np.repeat((2 * observations[:, None] + np.arange(2)).ravel(), width))
        columns.append(np.repeat(places[:, None, :], 2, axis=1).ravel())
    return sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


def _diagonal_scale(matrix: FloatArray) -> FloatArray:
    """Factors that bring a symmetric matrix's diagonal to ±1."""
    diagonal = np.abs(np.diag(matrix))
    return 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
