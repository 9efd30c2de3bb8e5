"""Least squares with a few shared parameters and many local ones: variable projection, block by block.

Each target has its own residues, which no other target sees; poles and table amplitudes are shared. The local
parameters of a block are eliminated by the QR factorisation of its columns A: what remains of the shared columns S and
of the residuals r is their part orthogonal to A. This is variable projection (Golub and Pereyra 1973,
doi:10.1137/0710036) in Kaufman's form (1975, doi:10.1007/BF01932995), here for unequal weights and several right-hand
sides. The covariance of all parameters follows from the same factors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.findings.response import FloatArray
from labdaemon.least_squares import damped_step, scaled_inverse

RANK_LIMIT = 1e-9
"""Columns of a block that are smaller than this after orthogonalisation, in units of the largest, are not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockSystem:
    """The linearised problem, weighted to unit variance: r ≈ A_t·δc_t + S_t·δp.

    Attributes
    ----------
    local, shared
        (T, R, L) and (T, R, n) derivatives of the predictions.
    residual
        (T, R) observed minus predicted.
    prior_weight, prior_residual
        (n,) inverse variances of the shared parameters' own observations, and those minus the present values.
    """

    local: FloatArray
    shared: FloatArray
    residual: FloatArray
    prior_weight: FloatArray
    prior_residual: FloatArray

    def factorise(self) -> ReducedSystem:
        """Eliminate the local parameters."""
        scale = np.linalg.norm(self.local, axis=1)
        scale = np.where(scale > 0, scale, 1.0)
        q, r = np.linalg.qr(self.local / scale[:, None, :])
        diagonal = np.abs(np.diagonal(r, axis1=1, axis2=2))
        seen = diagonal > RANK_LIMIT
        # A parameter that a block does not see keeps its value: its column leaves the basis.
        q = q * seen[:, None, :]
        r = np.where(seen[:, :, None], r, np.eye(r.shape[1])[None])
        on_shared = np.einsum("trl,trn->tln", q, self.shared)
        on_residual = np.einsum("trl,tr->tl", q, self.residual)
        rest = self.shared - q @ on_shared
        rest_residual = self.residual - np.einsum("trl,tl->tr", q, on_residual)
        flat = rest.reshape(rest.shape[0] * rest.shape[1], rest.shape[2])
        normal = flat.T @ flat + np.diag(self.prior_weight)
        gradient = flat.T @ rest_residual.ravel() + self.prior_weight * self.prior_residual
        inverse = np.linalg.inv(r) * seen[:, None, :] / scale[:, :, None]
        return ReducedSystem(normal, gradient, inverse, on_shared, on_residual)


@dataclass(frozen=True, slots=True, eq=False)
class ReducedSystem:
    """Normal equations of the shared parameters, and what leads back to the local ones.

    Attributes
    ----------
    normal, gradient
        (n, n) and (n,).
    inverse
        (T, L, L) inverse of each block's triangular factor.
    on_shared, on_residual
        (T, L, n) and (T, L) components of the shared columns and of the residuals in the block's own space.
    """

    normal: FloatArray
    gradient: FloatArray
    inverse: FloatArray
    on_shared: FloatArray
    on_residual: FloatArray

    def step(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Step of the shared (n,) and the local parameters (T, L)."""
        shared = damped_step(self.normal, self.gradient, damping) if len(self.gradient) else self.gradient
        local = np.einsum("tlm,tm->tl", self.inverse, self.on_residual - self.on_shared @ shared)
        return shared, local

    def covariance(self) -> BlockCovariance:
        """Covariance of all parameters."""
        own = self.inverse @ self.inverse.transpose(0, 2, 1)
        shared = scaled_inverse(self.normal) if len(self.normal) else self.normal
        return BlockCovariance(shared, own, self.inverse @ self.on_shared)


@dataclass(frozen=True, slots=True, eq=False)
class BlockCovariance:
    """Covariance of shared and local parameters in factored form.

    Attributes
    ----------
    shared
        (n, n).
    own
        (T, L, L) of the local parameters were the shared ones known.
    coupling
        (T, L, n) W: local parameters change by −W·δp with the shared ones.
    """

    shared: FloatArray
    own: FloatArray
    coupling: FloatArray

    def joint(self, shared_rows: FloatArray, local_rows: FloatArray) -> FloatArray:
        """(q, q) covariance of linear functions of all parameters.

        Parameters
        ----------
        shared_rows, local_rows
            (q, n) and (q, T, L) derivatives.
        """
        through = shared_rows - np.einsum("qtl,tln->qn", local_rows, self.coupling)
        own = np.einsum("qtl,tlm,ptm->qp", local_rows, self.own, local_rows, optimize=True)
        result: FloatArray = through @ self.shared @ through.T + own
        return result

    def local_block(self, target: int) -> FloatArray:
        """(L, L) covariance of the local parameters of one target."""
        w = self.coupling[target]
        result: FloatArray = self.own[target] + w @ self.shared @ w.T
        return result
