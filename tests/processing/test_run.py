"""Whole folders, rendered by the simulator (which shares no formula with the measurement), against their truth."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labdaemon.errors import DataError, LabdaemonError
from labdaemon.processing import measure_capture, prepare_sharp, process_folder
from labdaemon.processing.folder import open_folder
from labdaemon.processing.pool import WorkerPool
from labdaemon.processing.run import FolderResult, jobs
from labdaemon.processing.tables import Row
from labdrivers.sim.folder import make_folder


@pytest.fixture(scope="module")
def pool():
    with WorkerPool(2) as it:
        yield it


def truth(folder: Path) -> list[dict[str, str]]:
    with (folder / "truth.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def vector(row: Row | dict[str, str], *names: str) -> np.ndarray:
    values = [row[name] for name in names]
    return np.array([np.nan if value in (None, "") else float(str(value)) for value in values])


def errors(folder: Path, result: FolderResult) -> tuple[np.ndarray, int, int]:
    """(n,) length of the difference vector of the major axes, either sign, mm; flagged; missing."""
    off, flagged, missing = [], 0, 0
    for capture in result.captures:
        rows = [row for row in capture.envelope_rows if row["x_mm"] is not None]
        places = np.array([vector(row, "x_mm", "y_mm", "z_mm") for row in rows])
        for true in truth(folder):
            if true["capture"] != capture.name:
                continue
            distance = np.linalg.norm(places - vector(true, "x_mm", "y_mm", "z_mm"), axis=1)
            if distance.min() > 5:
                missing += 1
                continue
            row = rows[int(np.argmin(distance))]
            flagged += bool(row["flags"])
            pair = np.stack([vector(true, "ax", "ay", "az"), vector(true, "bx", "by", "bz")])
            major = np.linalg.svd(pair)[2][0] * np.linalg.svd(pair)[1][0]
            got = vector(row, "ax_mm", "ay_mm", "az_mm")
            off.append(min(np.linalg.norm(got - major), np.linalg.norm(got + major)))
    return np.array(off), flagged, missing


def test_one_camera(planar: Path, tmp_path: Path, pool: WorkerPool) -> None:
    said: list[tuple[str, int, int]] = []
    result = process_folder(planar, tmp_path / "out", pool=pool, progress=lambda *part: said.append(part))
    off, flagged, missing = errors(planar, result)
    assert (len(off), missing) == (24, 0)
    assert flagged <= 1
    assert np.percentile(off, 95) < 0.05
    assert said[-1] == ("envelopes", 2, 2)
    for row in result.captures[0].envelope_rows:
        assert row["ay_mm"] is not None  # in the plane of the survey, which is nearly y = 0
        assert abs(float(str(row["ay_mm"]))) < 0.05
        assert row["sd_ay_mm"] is None
    with (result.out / "envelope.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 24


def test_two_cameras_and_what_the_daemon_would_get(stereo: Path, tmp_path: Path, pool: WorkerPool) -> None:
    result = process_folder(stereo, tmp_path / "out", pool=pool)
    off, flagged, missing = errors(stereo, result)
    assert (len(off), missing) == (8, 0)
    assert flagged <= 1
    assert np.percentile(off, 95) < 0.1
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["envelope.csv", "measurements.csv"]
    names = {camera: set() for camera in ("left", "right")}
    for row in result.captures[0].measurement_rows:
        names[str(row["camera"])].add(row["target"])
    assert names["left"] == names["right"]
    again = measure_capture(stereo, prepare_sharp(stereo), result.captures[0].captures, "c1")
    assert again.envelope_rows == result.captures[0].envelope_rows
    assert again.measurement_rows == result.captures[0].measurement_rows


def test_names_stay_from_one_sharp_set_to_the_next(planar: Path) -> None:
    first = prepare_sharp(planar)
    odd = replace(first, targets=tuple(f"beam {k}" for k in range(12)), places_mm=first.places_mm[::-1])
    again = prepare_sharp(planar, like=odd)
    known = dict(zip(odd.targets, odd.places_mm, strict=True))
    assert sorted(again.targets) == sorted(odd.targets)
    for name, place in zip(again.targets, again.places_mm, strict=True):
        assert np.abs(known[name] - place).max() < 0.1


@pytest.mark.slow
def test_a_group_is_reported_once_with_signed_vectors(tmp_path: Path, pool: WorkerPool) -> None:
    folder = make_folder(
        tmp_path / "set",
        seed=43,
        cameras=1,
        targets=6,
        amplitude_mm=(2.0, 4.0),
        frequency_hz=5.5,
        phase_rad=[0.0, np.pi / 2],
    )
    result = process_folder(folder, tmp_path / "out", pool=pool)
    assert [capture.name for capture in result.captures] == ["c1"]
    assert len(result.captures[0].captures) == 2
    rows = result.captures[0].envelope_rows
    assert len(rows) == 6
    places = np.array([vector(row, "x_mm", "y_mm", "z_mm") for row in rows])
    for true in truth(folder):
        row = rows[int(np.argmin(np.linalg.norm(places - vector(true, "x_mm", "y_mm", "z_mm"), axis=1)))]
        a, b = vector(true, "ax", "ay", "az"), vector(true, "bx", "by", "bz")
        off = np.hypot(
            np.linalg.norm(vector(row, "ax_mm", "ay_mm", "az_mm") - a),
            np.linalg.norm(vector(row, "bx_mm", "by_mm", "bz_mm") - b),
        )
        assert off < 0.12 * np.hypot(np.linalg.norm(a), np.linalg.norm(b))


@pytest.mark.slow
def test_places_given_name_the_targets_and_moved_ones_are_found(tmp_path: Path, pool: WorkerPool) -> None:
    folder = make_folder(
        tmp_path / "set", seed=44, cameras=1, targets=9, rest_offset_mm=8.0, approximate_places=True, sharp_frames=2
    )
    with (folder / "targets.csv").open("a") as file:
        file.write("nowhere,900,0,350\n")
    result = process_folder(folder, tmp_path / "out", pool=pool)
    off, flagged, missing = errors(folder, result)
    assert (len(off), missing) == (9, 0)
    assert np.percentile(off, 95) < 0.05
    assert flagged <= 1
    with (folder / "targets.csv").open(newline="") as file:
        assert [row["target"] for row in result.captures[0].envelope_rows] == [r["name"] for r in csv.DictReader(file)]
    lost = result.captures[0].envelope_rows[-1]
    assert lost["flags"] == ["not_found"]
    assert all(lost[column] is None for column in ("x_mm", "ax_mm", "sd_ax_mm", "residual_ratio"))


def copy_of(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def test_a_group_and_its_sharp_set_are_checked_before_work(planar: Path, tmp_path: Path) -> None:
    folder = copy_of(planar, tmp_path)
    for name, text in (("c1", 'group = "g"\n'), ("c2", 'group = "g"\nsharp = "later"\n')):
        (folder / "captures" / name / "capture.toml").write_text(text)
    with pytest.raises(DataError, match="name different sharp sets"):
        jobs(open_folder(folder))
    (folder / "captures/c2/capture.toml").write_text('group = "g"\n')
    assert [(job.name, job.captures) for job in jobs(open_folder(folder))] == [("g", ("c1", "c2"))]
    for name, frequency in (("c1", 5.0), ("c2", 8.0)):
        (folder / f"captures/{name}/capture.toml").write_text(f'group = "g"\nfrequency_hz = {frequency}\n')
    with pytest.raises(DataError, match=r"group g have different frequencies: 5 Hz \(c1\) and 8 Hz \(c2\)"):
        process_folder(folder)
    (folder / "captures/c1/capture.toml").write_text('group = "g"\n')
    (folder / "captures/c2/capture.toml").write_text('group = "c1"\n')
    (folder / "captures/c1/capture.toml").write_text("")
    with pytest.raises(DataError, match="c1 is the name of a capture and of a group"):
        jobs(open_folder(folder))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("truncated", r"c1/front\.dng: the file is truncated"),
        ("missing", r"c1: no frame of camera front"),
        ("jpeg", r"c1/front\.dng: is a JPEG"),
        ("size", r"front\.dng: is 1936x1296 pixels, but image_size says 1934x1296"),
        ("few", r"sharp/front\.dng: 3 of the .* control targets"),
        ("diameter", r"rig\.toml: diameter_mm is 20, but the dots of the sharp frame measure"),
        ("set", r"sharp/later: the sharp set is missing"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    planar: Path, tmp_path: Path, pool: WorkerPool, change: str, said: str
) -> None:
    folder = copy_of(planar, tmp_path)
    frame = folder / "captures/c1/front.dng"
    rig = (folder / "rig.toml").read_text()
    if change == "truncated":
        frame.write_bytes(frame.read_bytes()[:1_000_000])
    elif change == "missing":
        frame.unlink()
    elif change == "jpeg":
        frame.write_bytes(b"\xff\xd8\xff\xe0" + bytes(1000))
    elif change == "size":
        (folder / "rig.toml").write_text(rig.replace("1936, 1296", "1934, 1296"))
    elif change == "few":
        lines = (folder / "control.csv").read_text().splitlines()
        others = [f"{9}{line}" for line in lines[4:]]
        (folder / "control.csv").write_text("\n".join([*lines[:4], *others]) + "\n")
    elif change == "diameter":
        (folder / "rig.toml").write_text(rig.replace("diameter_mm = 8.0", "diameter_mm = 20.0"))
        assert "20.0" in (folder / "rig.toml").read_text()
    else:
        (folder / "captures/c1/capture.toml").write_text('sharp = "later"\n')
    with pytest.raises(LabdaemonError, match=said) as caught:
        process_folder(folder, tmp_path / "out", pool=pool)
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_frames_of_two_cameras_swapped(stereo: Path, tmp_path: Path) -> None:
    folder = copy_of(stereo, tmp_path)
    left, right = folder / "captures/c1/left.dng", folder / "captures/c1/right.dng"
    left.rename(folder / "t.dng")
    right.rename(left)
    (folder / "t.dng").rename(right)
    with pytest.raises(DataError, match=r"captures/c1/left\.dng: .*is the frame from this camera"):
        measure_capture(folder, prepare_sharp(folder), ("c1",), "c1")


@pytest.mark.parametrize(("cameras", "tell"), [(1, "window"), (2, "all")])
def test_one_part_cycle_capture_gives_signs(tmp_path: Path, pool: WorkerPool, cameras: int, tell: str) -> None:
    """Of targets that move in phase: where each stood at the middle of the exposure, from the phase they share."""
    folder = make_folder(
        tmp_path / "set",
        seed=63 + cameras,
        cameras=cameras,
        targets=12,
        amplitude_mm=(1.0, 3.0),
        in_phase=True,
        exposure_s=1.1,
        tell=tell,
    )
    result = process_folder(folder, tmp_path / "out", pool=pool)
    rows = [row for row in result.captures[0].envelope_rows if row["x_mm"] is not None]
    places = np.array([vector(row, "x_mm", "y_mm", "z_mm") for row in rows])
    stated = 0
    for true in truth(folder):
        nearest = np.argmin(np.linalg.norm(places - vector(true, "x_mm", "y_mm", "z_mm"), axis=1))
        row = rows[int(nearest)]
        assert ("part_cycles" in row["flags"]) == (tell == "window")  # type: ignore[operator]
        if row["sign"] is None:
            continue
        stated += 1
        middle = np.pi * 5.5
        stood = vector(true, "ax", "ay", "az") * np.sin(middle) + vector(true, "bx", "by", "bz") * np.cos(middle)
        assert float(str(row["sign"])) * (np.nan_to_num(vector(row, "ax_mm", "ay_mm", "az_mm")) @ stood) > 0
    assert stated >= 9
    with (result.out / "measurements.csv").open(newline="") as file:
        assert {row["sign"] for row in csv.DictReader(file)} >= {"1", "-1"}


def test_a_gauge_that_stands_for_targets_changes_their_amplitudes_and_one_that_does_not_their_sd(
    planar: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "harmonics"
    shutil.copytree(planar, folder, ignore=shutil.ignore_patterns("results"))
    sharp = prepare_sharp(folder)
    [first, *_] = open_folder(folder).capture_names()
    about = folder / "captures" / first / "capture.toml"
    known = about.read_text() if about.exists() else ""
    rig = (folder / "rig.toml").read_text()
    gauge = "[gauges.response]\namplitude_mm = 2.0\nsd_amplitude_mm = 1e-4\nh2_mm = 0.0\nsd_h2_mm = 1e-4\n"
    gauge += "h3_mm = 0.1\nsd_h3_mm = 1e-4\nh3_phase_rad = 0.0\nsd_h3_phase_rad = 1e-3\n"
    found = {}
    for case, stands_for in (("sine", ""), ("unknown", ""), ("known", 'stands_for = "all"\n')):
        about.write_text(known + ("" if case == "sine" else gauge))
        section = f'[[gauge]]\nname = "response"\ndriver = "line"\nrole = "response"\nport = "x"\n{stands_for}'
        (folder / "rig.toml").write_text(rig + section)
        rows = measure_capture(folder, sharp, (first,), first).measurement_rows
        if case == "sine":
            moved = [r["target"] for r in rows if not r["flags"] and 2 < np.hypot(*vector(r, "ax_px", "ay_px")) < 6][:4]
        found[case] = np.array(
            [vector(r, "ax_px", "ay_px", "sd_ax_px", "sd_ay_px") for r in rows if r["target"] in moved]
        )
    size = np.linalg.norm(found["sine"][:, :2], axis=1)
    sd = {case: np.linalg.norm(rows[:, 2:], axis=1) for case, rows in found.items()}
    np.testing.assert_allclose(found["unknown"][:, :2], found["sine"][:, :2], atol=1e-6)
    np.testing.assert_allclose(sd["unknown"], np.hypot(sd["sine"], 0.35 * 0.05 * size), rtol=0.01)
    change = np.linalg.norm(found["known"][:, :2], axis=1) / size - 1
    assert np.all((np.abs(change) > 5e-4) & (np.abs(change) < 0.03))
    np.testing.assert_array_less(sd["known"], sd["unknown"])
