"""The exposure of a frame: as stated, else as the camera wrote it."""

from pathlib import Path

import pytest

from labdaemon.blur import ExposureWindow, LightCode
from labdaemon.processing.exposure import exposure_window, true_exposure_s
from labdaemon.processing.folder import CaptureFile
from labdaemon.processing.group import is_cycle_count_unknown


@pytest.mark.parametrize(
    ("written", "true"),
    [(1 / 3, 2 ** (-5 / 3)), (0.3, 2 ** (-5 / 3)), (1.3, 2 ** (1 / 3)), (10.0, 2 ** (10 / 3)), (1.074, 1.074)],
)
def test_named_steps_are_powers_of_the_third_root_of_two(written: float, true: float) -> None:
    assert true_exposure_s(written) == pytest.approx(true)


def test_a_frequency_alone_takes_the_time_in_the_frame(planar: Path) -> None:
    frame = next((planar / "captures").glob("*/*.nef"), None) or next((planar / "captures").glob("*/*.dng"))
    stated = CaptureFile(frequency_hz=5.0, exposure_s=0.9)
    assert exposure_window(stated, "front", frame) == stated.window("front")
    assert exposure_window(CaptureFile(), "front", frame) is None
    found = exposure_window(CaptureFile(frequency_hz=5.0), "front", frame)
    assert found is not None
    assert found.cycles == pytest.approx(5.0, rel=1e-3)
    assert found.sd_exposure_s > 0


def test_a_damaged_file_has_no_exposure(tmp_path: Path) -> None:
    (tmp_path / "front.dng").write_bytes(b"II*\0\xff\xff\xff\xff")
    assert exposure_window(CaptureFile(frequency_hz=5.0), "front", tmp_path / "front.dng") is None


def test_which_exposures_are_not_known_well_enough() -> None:
    assert is_cycle_count_unknown(None)
    assert is_cycle_count_unknown(ExposureWindow(5.0, 1.0, sd_exposure_s=0.02))
    assert not is_cycle_count_unknown(ExposureWindow(5.0, 1.0, sd_exposure_s=0.005))
    assert not is_cycle_count_unknown(ExposureWindow(5.0, 1.0, 0.0, sd_exposure_s=0.02))
    assert not is_cycle_count_unknown(ExposureWindow(5.0, 1.0, sd_exposure_s=0.02, light=LightCode((1.0, 0.0), 0.0, 5)))
