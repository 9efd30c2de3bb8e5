"""Data-set folders: the contract's files, and frames that show the truth beside them."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
import rawpy

from labdrivers.sim.folder import FolderScene, make_folder


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_stereo_folder_is_complete_and_its_tags_can_be_read(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "set", seed=3, targets=12, captures=2, approximate_places=True)
    rig = tomllib.loads((folder / "rig.toml").read_text())
    assert set(rig["cameras"]) == {"left", "right"}
    assert rig["targets"]["diameter_mm"] == 8.0
    assert len(rows(folder / "targets.csv")) == 12
    truth = rows(folder / "truth.csv")
    assert [r["capture"] for r in truth] == ["c1"] * 12 + ["c2"] * 12
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    control = {r["name"]: np.array([float(r[f"{c}_mm"]) for c in "xyz"]) for r in rows(folder / "control.csv")}
    for name, camera in rig["cameras"].items():
        with rawpy.imread(str(folder / "sharp" / f"{name}.dng")) as raw:
            mosaic = raw.raw_image_visible.astype(float)
        assert list(mosaic.shape[::-1]) == camera["image_size"]
        grey = np.clip(cv2.GaussianBlur(mosaic, (0, 0), 1.2) / 12.0, 0, 255).astype(np.uint8)
        _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(grey)
        assert {str(i) for i in ids.ravel()} == set(control)
    told = tomllib.loads((folder / "captures" / "c1" / "capture.toml").read_text())
    assert told == {"frequency_hz": 5.0, "exposure_s": 1.0, "phase_rad": 0.0}
    assert not list(folder.rglob("*.part"))


def test_groups_share_a_motion_and_amplitudes_keep_their_range(tmp_path: Path) -> None:
    folder = make_folder(
        tmp_path / "set",
        seed=4,
        cameras=1,
        targets=6,
        amplitude_mm=(0.5, 2.0),
        orbit=0.5,
        exposure_s=1.1,
        phase_rad=(0.0, 1.5708),
        sharp_frames=2,
    )
    names = sorted(p.parent.name for p in folder.glob("captures/*/front.dng"))
    assert names == ["c1-1", "c1-2"]
    groups = [tomllib.loads((folder / "captures" / n / "capture.toml").read_text()) for n in names]
    assert [g["group"] for g in groups] == ["c1", "c1"]
    assert [g["phase_rad"] for g in groups] == [0.0, 1.5708]
    assert (folder / "sharp" / "front-2.dng").exists()
    for row in rows(folder / "truth.csv"):
        axes = np.array([[float(row[f"{v}{c}"]) for c in "xyz"] for v in "ab"])
        minor, major = np.sqrt(np.linalg.eigvalsh(axes @ axes.T))
        assert 0.5 <= major <= 2.0
        assert minor / major == pytest.approx(0.5, abs=1e-3)
        assert axes[:, 1] == pytest.approx(0.0)


def test_three_cameras_see_every_target_and_light_and_things_in_the_way_are_as_asked(tmp_path: Path) -> None:
    folder = make_folder(
        tmp_path / "set", seed=6, cameras=3, targets=6, occluded=2, white_dn=5200.0, pattern="GBRG", tell="nothing"
    )
    rig = tomllib.loads((folder / "rig.toml").read_text())
    assert list(rig["cameras"]) == ["left", "right", "top"]
    for name in rig["cameras"]:
        for kind, clipped in (("sharp", False), ("captures/c1", True)):
            with rawpy.imread(str(folder / kind / f"{name}.dng")) as raw:
                letters = "".join(raw.color_desc.decode()[i] for i in raw.raw_pattern.ravel())
                assert letters == "GBRG"
                share = np.mean(raw.raw_image_visible == 4095)
                assert (share > 0.002) == clipped
    assert not list(folder.glob("captures/*/capture.toml"))


def test_the_same_seed_is_the_same_folder(tmp_path: Path) -> None:
    one, two = (make_folder(tmp_path / n, seed=5, cameras=1, targets=4) for n in "ab")
    for file in sorted(p for p in one.rglob("*") if p.is_file()):
        assert file.read_bytes() == (two / file.relative_to(one)).read_bytes()


@pytest.mark.parametrize("wrong", [{"cameras": 4}, {"size": "huge"}, {"targets": 400}, {"tell": "some"}])
def test_what_it_cannot_do_it_says_before_writing(tmp_path: Path, wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"must be|do not fit"):
        make_folder(tmp_path / "set", **wrong)  # type: ignore[arg-type]
    assert not (tmp_path / "set").exists()


def test_a_scene_and_its_changes_are_one_description(tmp_path: Path) -> None:
    scene = FolderScene(seed=2, cameras=1, targets=2, tell="nothing")
    one = make_folder(tmp_path / "a", scene, diameters_mm=[8.0])
    two = make_folder(tmp_path / "b", seed=2, cameras=1, targets=2, tell="nothing")
    assert (one / "truth.csv").read_text() == (two / "truth.csv").read_text()
    with pytest.raises(TypeError, match="no option 'colour'"):
        make_folder(tmp_path / "c", colour=1)
    with pytest.raises(ValueError, match="tell must be"):
        FolderScene(tell="some")
