"""A data-set folder with results: three frequencies, one group of known phase, one target that is not found."""

from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.flags import Flag

HEADER = (
    "capture,target,x_mm,y_mm,z_mm,ax_mm,ay_mm,az_mm,bx_mm,by_mm,bz_mm,sd_x_mm,sd_y_mm,sd_z_mm,sd_ax_mm,sd_ay_mm,"
    "sd_az_mm,sd_bx_mm,sd_by_mm,sd_bz_mm,residual_ratio,flags,sign,cor_ax_az"
)
CAPTURES = {"five": (5.0, 2.0), "eight": (8.0, 1.0), "twelve": (12.0, 0.5)}
"""Name of a capture -> frequency in Hz, amplitude of the table in mm."""
TARGETS = ("T1", "T2", "nœud 3")


def row(capture: str, target: str, index: int, scale: float) -> str:
    if capture == "twelve" and target == "T2":
        return f"{capture},{target}{',' * 20}{Flag.NOT_FOUND.value},,"
    motion = [scale * (index + 1), 0.0, 0.25 * scale, 0.0, 0.125 * scale, 0.0]
    values = [100.0 * index, 10.0, 50.0 * index, *motion, *[0.01] * 3, *[0.002] * 6]
    flags = "at_rest;camera_moved" if target == "nœud 3" and capture == "five" else ""
    return (
        f"{capture},{target},"
        + ",".join(f"{value:.6f}" for value in values)
        + f",,{flags},,{0.4 if target == 'T2' else ''}"
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "three-modes"
    (root / "results").mkdir(parents=True)
    lines = [HEADER]
    for capture, (frequency, table) in CAPTURES.items():
        lines += [row(capture, target, index, 2.0 * table) for index, target in enumerate(TARGETS)]
        members = ["eight-1", "eight-2"] if capture == "eight" else [capture]
        for number, member in enumerate(members):
            where = root / "captures" / member
            where.mkdir(parents=True)
            text = f"frequency_hz = {frequency}\nexcitation_amplitude_mm = {table}\n"
            text += 'exposure_s = 1.0\nopened_at = "2026-05-04T10:11:12Z"\n'
            if capture == "eight":
                text = text.replace("exposure_s = 1.0", "exposure_s = 0.6875")
                text += f'group = "eight"\nphase_rad = {1.5708 * number}\n'
            (where / "capture.toml").write_text(text, encoding="utf-8")
    (root / "results" / "envelope.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return root
