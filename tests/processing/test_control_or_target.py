"""A control target is never a monitoring target: not by name, not by place, not where its code could not be read."""

import csv
from pathlib import Path

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry import Lens, OrientedCamera
from labdaemon.processing.control import surveyed_outlines
from labdaemon.processing.naming import other_names
from labdaemon.processing.sharpset import prepare_sharp
from labdaemon.processing.survey import SurveyedPoint, read_targets
from labdrivers.sim.folder import make_folder

CONTROL = tuple(SurveyedPoint(str(k), 100.0 * k, 0.0, 50.0, 0.1) for k in range(4))


def targets(path: Path, rows: str) -> Path:
    file = path / "targets.csv"
    file.write_text("name,x_mm,y_mm,z_mm\n" + rows)
    return file


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("a,10,0,90\n2,150,0,90\n", "2 is a control target"),
        ("a,10,0,90\nb,205,3,52\n", "b lies 6.16 mm from control target 2"),
    ],
)
def test_a_control_target_among_the_targets_is_refused(tmp_path: Path, rows: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        read_targets(targets(tmp_path, rows), CONTROL, 36.0)


def test_a_target_next_to_a_control_target_is_taken(tmp_path: Path) -> None:
    assert len(read_targets(targets(tmp_path, "a,230,0,50\n"), CONTROL, 36.0)) == 1


def test_new_names_are_none_of_the_control_targets() -> None:
    names = other_names(["T01", "T02", "T03"], {"T02", "T00"})
    assert names[0] == "T01"
    assert names[2] == "T03"
    assert names[1] not in {"T00", "T01", "T02", "T03"}


@pytest.mark.parametrize(("family", "radius"), [("apriltag-36h11", 18.0), ("ring-12", 9.0)])
def test_outlines_lie_around_the_projected_survey(family: str, radius: float) -> None:
    lens = Lens((4000, 3000), (4000.0, 4000.0), (2000.0, 1500.0), (0.0,) * 5)
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    view = OrientedCamera(lens, rotation, np.array([150.0, -1000.0, 50.0]))
    outlines = surveyed_outlines(view, CONTROL, 36.0, family)
    centres = view.project(np.array([(p.x_mm, p.y_mm, p.z_mm) for p in CONTROL]))
    for outline, centre in zip(outlines, centres, strict=True):
        assert np.hypot(*(outline - centre).T) == pytest.approx(4.0 * radius, rel=1e-6)


def test_no_target_of_a_simulated_folder_is_a_control_target(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "set", seed=3, cameras=1, targets=6, size="small")
    # An unread control target is still in the survey: its place must not become a target's.
    prepared = prepare_sharp(folder)
    with (folder / "control.csv").open(newline="") as file:
        control = list(csv.DictReader(file))
    assert not {row["name"] for row in control} & set(prepared.targets)
    places = np.array([[float(row[key]) for key in ("x_mm", "y_mm", "z_mm")] for row in control])
    assert np.min(np.linalg.norm(prepared.places_mm[:, None] - places[None], axis=2)) > 10.0
