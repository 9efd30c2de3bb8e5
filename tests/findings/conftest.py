from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.findings import ModeSearch, find_modes


def shared_modal() -> Path:
    """Folder of measured modal data; the test is skipped where it is not."""
    root = Path(__file__).resolve().parents[2]
    folder = Path(os.environ.get("LABDAEMON_SHARED", root.parent / "shared")) / "data" / "modal"
    if not folder.is_dir():
        pytest.skip(f"no measured modal data in {folder}: set LABDAEMON_SHARED")
    return folder


@pytest.fixture(scope="session")
def modal_data() -> Path:
    return shared_modal()


@pytest.fixture(scope="session")
def structure() -> ShearStructure:
    return ShearStructure(per_column=4)


@pytest.fixture(scope="session")
def swept(structure: ShearStructure) -> ModeSearch:
    """Modes of an amplitude-only sweep of 26 steps over two of the four modes."""
    series = Instrument().measure(structure, np.geomspace(4.0, 18.0, 26), np.random.default_rng(1))
    return find_modes(series)
