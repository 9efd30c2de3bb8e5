"""Whole folders in which something hangs in front of some dots: those are said to be covered, and no others."""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from labdaemon.processing.envelope import measure_capture
from labdaemon.processing.sharpset import prepare_sharp
from labdrivers.sim.folder import make_folder
from labdrivers.sim.scene import Occluder

pytestmark = pytest.mark.slow
COVERED = 5


@pytest.mark.parametrize(
    ("seed", "reflectance", "diameters_mm", "size"),
    [(61, 0.05, (5.0, 8.0, 12.0), "small"), (62, 0.85, (8.0, 12.0), "small"), (63, 0.3, (8.0, 12.0), "d80")],
    ids=["dark", "as white as paper", "grey, fine pixels"],
)
def test_covered_dots_are_right_or_without_numbers(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    seed: int,
    reflectance: float,
    diameters_mm: tuple[float, ...],
    size: str,
) -> None:
    monkeypatch.setattr("labdrivers.sim.folder.Occluder", partial(Occluder, reflectance=reflectance))
    folder = make_folder(
        tmp_path / "set",
        seed=seed,
        cameras=1,
        targets=18,
        occluded=COVERED,
        diameters_mm=diameters_mm,
        amplitude_mm=(0.3, 4.0),
        size=size,
    )
    prepared = prepare_sharp(folder)
    result = measure_capture(folder, prepared, ("c1",), "c1")
    with (folder / "truth.csv").open(newline="") as file:
        truth = list(csv.DictReader(file))
    places = np.array([[float(row[key]) for key in ("x_mm", "y_mm", "z_mm")] for row in truth])
    covered = measured = 0
    for place, row in zip(prepared.places_mm, result.envelope_rows, strict=True):
        flags = row["flags"]
        true = truth[int(np.argmin(np.linalg.norm(places - place, axis=1)))]
        covered += "occluded" in flags
        assert "poor_fit" not in flags
        if row["ax_mm"] is None:
            assert "occluded" in flags
            continue
        assert not flags or set(flags) <= {"occluded", "at_rest"}
        a = np.array([float(row[key]) for key in ("ax_mm", "ay_mm", "az_mm")])
        sd = np.hypot(float(row["sd_ax_mm"]), float(row["sd_az_mm"]))
        length = np.linalg.norm([float(true[key]) for key in ("ax", "ay", "az", "bx", "by", "bz")])
        assert abs(np.linalg.norm(a) - length) < 4 * sd + 0.01
        measured += 1
    assert covered == COVERED
    assert measured >= 18 - COVERED + (3 if size == "d80" else 0)
