"""Gauss–Legendre nodes."""

import numpy as np
import pytest

from labdaemon.blur.quadrature import gauss_legendre


def test_nodes_integrate_a_polynomial_exactly() -> None:
    nodes, weight = gauss_legendre(4)
    assert weight @ nodes**6 == pytest.approx(2 / 7, abs=1e-14)


def test_shared_nodes_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        gauss_legendre(5)[0][0] = 0.0
    assert np.isfinite(gauss_legendre(5)[0]).all()
