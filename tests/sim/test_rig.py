"""Table, structure and cameras as one rig."""

from __future__ import annotations

import io
import pickle

import numpy as np
import pytest
import rawpy

from labdrivers.sim.rig import RigModel, render_exposure, render_job
from labdrivers.sim.spec import CameraSpec, RigSpec

SMALL = CameraSpec(
    "6000009",
    (-520.0, -1330.0, 470.0),
    image_size=(486, 325),
    focal_px=(492.2, 492.2),
    principal_point_px=(244.6, 162.0),
)


def level_for(rig: RigModel, frequency_hz: float, amplitude_mm: float) -> float:
    return amplitude_mm / abs(rig.spec.table.response(frequency_hz))


def test_every_dot_moves_measurably_at_all_three_modes_and_stays_on_its_paper() -> None:
    rig = RigModel()
    for k, (frequency, amplitude) in enumerate(((5.0, 2.0), (8.0, 1.0), (12.0, 0.5))):
        rig.drive(200.0 * k, frequency_hz=frequency, level_v=level_for(rig, frequency, amplitude), running=True)
        truth = rig.truth(200.0 * k + 60.0, 1.0)
        vectors = np.array([[[t[f"{v}{c}_mm"] for c in "xyz"] for v in "ab"] for t in truth["targets"].values()])
        major = np.sqrt(np.linalg.eigvalsh(vectors @ vectors.transpose(0, 2, 1))[:, -1])
        assert len(major) == 24
        assert np.median(major) > 0.5
        for target, reach in zip(rig.spec.targets, major, strict=True):
            assert reach < min(target.paper_mm) / 2 - target.diameter_mm / 2 - 2.0
        assert np.abs(vectors[:, :, 1]).max() > 0.2, "the structure also moves across the table"
        assert truth["frequency_hz"] == frequency


def test_truth_is_the_motion_in_the_window() -> None:
    rig = RigModel()
    rig.drive(0.0, frequency_hz=5.0, level_v=0.5, running=True)
    truth = rig.truth(45.07, 1.0)
    row = truth["targets"]["R12"]
    point = np.array([rig.spec.targets[-1].centre_mm])
    t = 45.07 + np.linspace(0.0, 1.0, 50)
    angle = truth["phase_rad"] + 2 * np.pi * 5.0 * (t - 45.07)
    a, b = (np.array([row[f"{v}{c}_mm"] for c in "xyz"]) for v in "ab")
    expected = np.outer(np.sin(angle), a) + np.outer(np.cos(angle), b)
    np.testing.assert_allclose(rig.displacement_mm(point, t)[0], expected, atol=5e-3)
    assert rig.excitation_phase(45.07) == pytest.approx(truth["phase_rad"])


def test_stopping_and_dropping_the_enable_line_bring_the_table_to_rest() -> None:
    for stop in ("generator", "enable"):
        rig = RigModel()
        assert not rig.moving(0.0)
        rig.drive(0.0, frequency_hz=5.0, level_v=0.5, running=True)
        assert rig.moving(5.0)
        if stop == "generator":
            rig.drive(10.0, frequency_hz=5.0, level_v=0.5, running=False)
        else:
            rig.enable(10.0, False)
        assert not rig.moving(12.0)
        assert rig.moving(9.0), "what was stays as it was"
        assert np.ptp(rig.response_mm(np.linspace(12.0, 12.5, 50))) > 0.5, "the structure rings on"
        assert rig.frequency_hz(12.0) is None


def test_beyond_its_limits_the_amplifier_trips_until_told_to_stop() -> None:
    rig = RigModel()
    rig.drive(0.0, frequency_hz=12.0, level_v=level_for(rig, 12.0, 20.0), running=True)
    assert rig.tripped is not None
    assert "velocity" in rig.tripped
    assert not rig.moving(3.0)
    rig.drive(4.0, frequency_hz=12.0, level_v=0.1, running=True)
    assert not rig.moving(6.0)
    rig.drive(7.0, frequency_hz=12.0, level_v=0.1, running=False)
    rig.drive(8.0, frequency_hz=12.0, level_v=0.1, running=True)
    assert rig.tripped is None
    assert rig.moving(10.0)


def test_ramping_in_small_steps_keeps_phase_and_stays_small() -> None:
    rig = RigModel()
    for k in range(400):
        rig.drive(0.05 * k, frequency_hz=5.0, level_v=0.5 * min(1.0, k / 100), running=True)
    assert rig.excitation_phase(20.0) == pytest.approx(2 * np.pi * 5.0 * 20.0, abs=1e-6)
    job = rig.exposure_job("left", 18.0, 1.0)
    assert len(job.history.intervals) < 25
    assert len(pickle.dumps(job)) < 100_000
    x = rig.table_mm(np.linspace(25.0, 26.0, 400, endpoint=False))
    assert np.ptp(x) / 2 == pytest.approx(0.5 * abs(rig.spec.table.response(5.0)), rel=1e-3)


def test_accelerometer_reads_the_second_derivative() -> None:
    rig = RigModel()
    rig.drive(0.0, frequency_hz=5.0, level_v=0.5, running=True)
    t = 50.0 + np.linspace(0.0, 1.0, 500, endpoint=False)
    ratio = np.ptp(rig.acceleration_m_s2(t)) / np.ptp(rig.response_mm(t))
    assert ratio == pytest.approx((2 * np.pi * 5.0) ** 2 * 1e-3, rel=1e-3)


def test_a_job_renders_the_same_file_anywhere() -> None:
    spec = RigSpec(cameras={"left": SMALL})
    rig = RigModel(spec)
    rig.drive(0.0, frequency_hz=5.0, level_v=0.5, running=True)
    job = rig.exposure_job("left", 30.0, 1.0, captured_at="2026:05:04 10:11:12")
    data = render_job(pickle.loads(pickle.dumps(job)))
    assert data == render_job(job)
    with rawpy.imread(io.BytesIO(data)) as raw:
        assert raw.raw_image_visible.shape == (325, 486)
    assert [record["camera"] for record in rig.records] == ["left"]
    other = render_exposure(rig.exposure_job("left", 40.0, 1.0))
    assert np.any(other.mosaic != render_exposure(job).mosaic)


def test_exposure_time_sensitivity_and_aperture_change_the_light() -> None:
    rig = RigModel(RigSpec(cameras={"left": SMALL}))
    means = [
        render_exposure(rig.exposure_job("left", 0.0, s, iso=iso, f_number=f)).mean_dn.mean()
        for s, iso, f in ((1.0, 100, 32.0), (0.5, 100, 32.0), (0.5, 200, 32.0), (0.25, 100, 16.0))
    ]
    assert means[1] / means[0] == pytest.approx(0.5, rel=1e-3)
    assert means[2] / means[0] == pytest.approx(1.0, rel=1e-3)
    assert means[3] / means[0] == pytest.approx(1.0, rel=1e-2)


def test_control_survey_is_as_good_as_it_says() -> None:
    spec = RigSpec()
    lines = spec.control_csv().splitlines()
    assert lines[0] == "name,x_mm,y_mm,z_mm,sd_mm"
    surveyed = np.array([[float(v) for v in line.split(",")[1:4]] for line in lines[1:]])
    error = surveyed - np.array([tag.centre_mm for tag in spec.tags])
    assert 0.02 < error.std() < 0.1
    assert spec.control_csv() == RigSpec().control_csv()
    assert len(spec.targets_csv().splitlines()) == 25


def test_nothing_hides_a_target_and_all_are_in_view() -> None:
    spec = RigSpec()
    for seen in spec.cameras.values():
        camera = seen.camera()
        boxes = []
        for target in spec.targets:
            half = np.array(target.paper_mm) / 2
            corners = target.points(np.array([(i * half[0], j * half[1]) for i in (-1, 1) for j in (-1, 1)]))
            away = np.array([7.0, 0.0, 0.0])
            boxes.append(camera.project(np.concatenate([corners + away, corners - away])))
        for tag in spec.tags:
            half = np.full(2, tag.card_mm / 2)
            boxes.append(
                camera.project(tag.points(np.array([(i * half[0], j * half[1]) for i in (-1, 1) for j in (-1, 1)])))
            )
        low, high = (np.array([reduce(box, axis=0) for box in boxes]) for reduce in (np.min, np.max))
        assert low.min() > 5.0
        assert np.all(high < np.array(seen.image_size) - 5.0)
        dots = len(spec.targets)
        meets = np.all((low[:, None] < high[None]) & (low[None] < high[:, None]), axis=2)
        assert not meets[dots:, :dots].any()
