from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.motion import Measurement
from labdaemon.envelope import TargetEnvelope
from labdaemon.errors import DataError
from labdaemon.flags import Flag
from labdaemon.geometry.motion import ObjectMotion
from labdaemon.processing.result_reader import read_csv
from labdaemon.processing.tables import (
    ENVELOPE_COLUMNS,
    MEASUREMENT_COLUMNS,
    csv_text,
    envelope_row,
    measurement_row,
    write_csv,
)


def test_columns_are_the_contract_s() -> None:
    assert ",".join(MEASUREMENT_COLUMNS) == (
        "capture,camera,target,x_px,y_px,ax_px,ay_px,bx_px,by_px,sd_x_px,sd_y_px,sd_ax_px,sd_ay_px,sd_bx_px,sd_by_px,flags,sign"
    )
    assert ",".join(ENVELOPE_COLUMNS) == (
        "capture,target,x_mm,y_mm,z_mm,ax_mm,ay_mm,az_mm,bx_mm,by_mm,bz_mm,sd_x_mm,sd_y_mm,sd_z_mm,"
        "sd_ax_mm,sd_ay_mm,sd_az_mm,sd_bx_mm,sd_by_mm,sd_bz_mm,residual_ratio,flags,sign,"
        "cor_x_y,cor_x_z,cor_y_z,cor_ax_ay,cor_ax_az,cor_ax_bx,cor_ax_by,cor_ax_bz,cor_ay_az,cor_ay_bx,cor_ay_by,"
        "cor_ay_bz,cor_az_bx,cor_az_by,cor_az_bz,cor_bx_by,cor_bx_bz,cor_by_bz"
    )


def test_a_name_that_is_no_text_is_spelled_out(tmp_path: Path) -> None:
    row = measurement_row("c\udcff", "", measurement())
    write_csv(tmp_path / "m.csv", MEASUREMENT_COLUMNS, [row])
    assert "c\\udcff,,T01," in (tmp_path / "m.csv").read_text()


def measurement(value: float = 1.0) -> Measurement:
    return Measurement(
        "T01",
        np.array([value, 2.0]),
        np.array([3.0, 4.0]),
        np.array([-5.0, 6.0]),
        np.diag(np.arange(1.0, 7.0) ** 2),
        flags=frozenset({Flag.POOR_FIT, Flag.SATURATED}),
    )


def test_a_measurement_s_row() -> None:
    row = measurement_row("c1", "left", measurement())
    assert [row[f"sd_{k}_px"] for k in ("x", "y", "ax", "ay", "bx", "by")] == [1, 2, 3, 4, 5, 6]
    assert row["flags"] == ["saturated", "poor_fit"]
    assert csv_text(MEASUREMENT_COLUMNS, [row]).splitlines()[1].endswith(",saturated;poor_fit,")


def test_a_sign_is_the_last_column_and_empty_where_unknown() -> None:
    row = measurement_row("c1", "left", measurement(), -1)
    assert row["sign"] == -1
    assert csv_text(MEASUREMENT_COLUMNS, [row]).splitlines()[1].endswith(",-1")
    assert measurement_row("c1", "left", measurement())["sign"] is None
    row = envelope_row("c1", "T01", None, [], 1)
    assert json.dumps(row["sign"]) == "1"
    old = {name: value for name, value in row.items() if name != "sign" and not name.startswith("cor_")}
    assert csv_text(ENVELOPE_COLUMNS, [old]).splitlines()[1].endswith(19 * ","), "as a journal had it before"


def test_what_was_not_measured_is_empty_never_a_number() -> None:
    nan = np.full(2, np.nan)
    lost = Measurement("T01", nan, nan, nan, np.full((6, 6), np.nan), flags=frozenset({Flag.NOT_FOUND}))
    text = csv_text(MEASUREMENT_COLUMNS, [measurement_row("c1", "left", lost)])
    assert text.splitlines()[1] == "c1,left,T01" + "," * 12 + ",not_found,"
    text = csv_text(ENVELOPE_COLUMNS, [envelope_row("c1", "T01", None, [Flag.NOT_FOUND])])
    assert text.splitlines()[1] == "c1,T01" + "," * 19 + ",not_found," + "," * 18


def test_one_camera_leaves_the_normal_s_sd_empty() -> None:
    covariance = np.diag(np.full(9, 4.0))
    covariance[[1, 4, 7]] = np.nan
    covariance[:, [1, 4, 7]] = np.nan
    motion = ObjectMotion(np.array([1.0, 0.0, 2.0]), np.array([3.0, 0.0, 4.0]), np.zeros(3), covariance, None)
    row = envelope_row("c1", "T01", motion, [])
    assert (row["sd_x_mm"], row["sd_y_mm"], row["sd_ay_mm"]) == (2.0, None, None)
    assert row["ay_mm"] == 0.0
    assert row["residual_ratio"] is None
    assert (row["cor_x_y"], row["cor_x_z"], row["cor_ax_az"]) == (None, 0.0, 0.0)
    json.dumps(row, allow_nan=False)


def test_the_covariance_is_in_the_row(tmp_path: Path) -> None:
    root = np.random.default_rng(1).normal(size=(9, 9)) * 0.1
    motion = ObjectMotion(np.ones(3), np.ones(3), np.zeros(3), root @ root.T, None)
    write_csv(tmp_path / "envelope.csv", ENVELOPE_COLUMNS, [envelope_row("c1", "T01", motion, [])])
    one = TargetEnvelope.from_row(read_csv(tmp_path / "envelope.csv")[0])
    assert one.covariance_mean_mm2 == pytest.approx((root @ root.T)[:3, :3], abs=2e-5)
    assert one.covariance_motion_mm2 == pytest.approx((root @ root.T)[3:, 3:], abs=2e-5)


@settings(max_examples=40, deadline=None)
@given(st.floats(-1e6, 1e6), st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), min_size=1))
def test_file_and_row_agree_exactly(tmp_path_factory: pytest.TempPathFactory, value: float, name: str) -> None:
    path = tmp_path_factory.getbasetemp() / "rows.csv"
    rows = [measurement_row(name, camera, measurement(value)) for camera in ("left", "right")]
    write_csv(path, MEASUREMENT_COLUMNS, rows)
    assert read_csv(path) == rows


def test_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "results" / "measurements.csv"
    write_csv(path, MEASUREMENT_COLUMNS, [measurement_row("c1", "left", measurement())])
    before = path.read_bytes()
    broken = measurement_row("c2", "left", measurement())
    del broken["x_px"]
    with pytest.raises(KeyError):
        write_csv(path, MEASUREMENT_COLUMNS, [broken])
    assert path.read_bytes() == before
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_csv(tmp_path / "file" / "x.csv", MEASUREMENT_COLUMNS, [])
    assert sorted(p.name for p in path.parent.iterdir()) == ["measurements.csv"]
