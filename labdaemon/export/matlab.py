"""MATLAB: one struct `labdaemon` with arrays over captures, targets and x, y, z."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import savemat

from labdaemon.export.cube import EnvelopeCube
from labdaemon.export.results import FolderResults
from labdaemon.version import __version__


def write(results: FolderResults, path: Path) -> None:
    """Write the file (level 5, which MATLAB, Octave and scipy read)."""
    cube = EnvelopeCube.of(results)
    content = {
        "source": f"labdaemon {__version__}",
        "title": results.folder.resolve().name,
        "capture": np.array(cube.captures, dtype=object),
        "target": np.array(cube.targets, dtype=object),
        "opened_at": cube.opened_at.astype(object),
        "is_phase_known": cube.is_phase_known,
        "flags": cube.flags.astype(object),
        "complex_amplitude_mm": cube.complex_amplitude_mm,
        **cube.per_capture,
        **cube.vectors,
        **cube.scalars,
        **cube.covariances,
    }
    savemat(path, {"labdaemon": content}, appendmat=False, do_compression=True, oned_as="column")
