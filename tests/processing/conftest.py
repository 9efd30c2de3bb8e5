"""Rendered data-set folders that several test modules process."""

from __future__ import annotations

from pathlib import Path

import pytest

from labdrivers.sim.folder import make_folder


@pytest.fixture(scope="session")
def planar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One camera, twelve dots, two captures."""
    return make_folder(tmp_path_factory.mktemp("planar") / "set", seed=41, cameras=1, targets=12, captures=2)


@pytest.fixture(scope="session")
def stereo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras, twelve dots, one capture, every frame shifted a little."""
    return make_folder(tmp_path_factory.mktemp("stereo") / "set", seed=42, cameras=2, targets=8, camera_shift_px=0.4)
