"""What a folder holds, read once for all formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.export import EnvelopeCube, read_results


def test_envelopes_have_the_facts_of_their_captures(folder: Path):
    results = read_results(folder)
    assert [one.capture for one in results.envelopes] == ["five", "eight", "twelve"]
    assert [one.frequency_hz for one in results.envelopes] == [5.0, 8.0, 12.0]
    assert results.envelopes[2].excitation_amplitude_mm == 0.5
    assert results.facts[1].captures == ("eight-1", "eight-2")
    assert results.targets == ("T1", "T2", "nœud 3")


def test_two_openings_of_part_cycles_and_known_phase_show_phase(folder: Path):
    assert [one.is_phase_known for one in read_results(folder).facts] == [False, True, False]


def test_one_opening_or_whole_cycles_show_no_phase(folder: Path):
    path = folder / "captures" / "eight-2" / "capture.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("0.6875", "1.0"), encoding="utf-8")
    assert not read_results(folder).facts[1].is_phase_known


def test_coded_light_of_known_phase_shows_phase_in_one_capture(folder: Path):
    path = folder / "captures" / "five" / "capture.toml"
    stated = path.read_text(encoding="utf-8") + "light = [1, 1, 1, 0, 1, 0, 0]\nlight_cycles = 5\n"
    path.write_text(stated, encoding="utf-8")
    assert not read_results(folder).facts[0].is_phase_known
    path.write_text(stated + "light_phase_rad = 0.2\n", encoding="utf-8")
    assert read_results(folder).facts[0].is_phase_known


def test_a_capture_without_a_file_has_unknown_facts(folder: Path):
    (folder / "captures" / "five" / "capture.toml").unlink()
    results = read_results(folder)
    assert results.envelopes[0].frequency_hz is None
    assert np.isnan(EnvelopeCube.of(results).per_capture["frequency_hz"][0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "labdaemon process"),
        ("", "no envelope yet"),
        ("one,two\n1,2\n", "its columns are one, two"),
        ("capture,target,ax_mm\nfive,T1,many\n", "lacks the columns x_mm, y_mm"),
    ],
)
def test_results_that_cannot_be_read_are_named(folder: Path, text: str | None, said: str):
    path = folder / "results" / "envelope.csv"
    path.unlink() if text is None else path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=said) as caught:
        read_results(folder)
    assert str(path) in str(caught.value)


def test_results_of_other_captures_are_refused(folder: Path):
    path = folder / "results" / "envelope.csv"
    lines = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    swapped = [",".join([line[1], line[0], *line[2:]]) for line in lines[1:]]
    path.write_text("\n".join([",".join(lines[0]), *swapped]), encoding="utf-8")
    with pytest.raises(DataError, match="results are of T1, T2, nœud 3, but its captures are eight, five, twelve"):
        read_results(folder)


def test_captures_without_files_are_next_to_those_that_have_some(folder: Path):
    """One was measured before the others were taken."""
    for name in ("five", "eight-1", "eight-2"):
        (folder / "captures" / name / "capture.toml").unlink()
    path = folder / "results" / "envelope.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(line for line in lines if line.startswith(("capture", "five"))), encoding="utf-8")
    assert read_results(folder).facts[0].frequency_hz is None


def test_a_folder_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(DataError, match="is not a folder"):
        read_results(tmp_path / "nowhere")


def test_the_cube_keeps_the_place_of_what_was_not_measured(folder: Path):
    cube = EnvelopeCube.of(read_results(folder))
    assert cube.vectors["a_mm"].shape == (3, 3, 3)
    assert np.isnan(cube.vectors["a_mm"][2, 1]).all()
    assert np.isnan(cube.scalars["amplitude_mm"][2, 1])
    assert cube.flags[2, 1] == "not_found"
    assert cube.flags[0, 2] == "at_rest;camera_moved"
    np.testing.assert_allclose(cube.vectors["a_mm"][0, 1], [8.0, 0.0, 1.0])


def test_the_complex_amplitude_gives_the_motion_back(folder: Path):
    cube = EnvelopeCube.of(read_results(folder))
    angle = np.linspace(0.0, 2.0 * np.pi, 50)[:, None]
    motion = np.real(cube.complex_amplitude_mm[1, 0] * np.exp(1j * angle))
    expected = cube.vectors["a_mm"][1, 0] * np.sin(angle) + cube.vectors["b_mm"][1, 0] * np.cos(angle)
    np.testing.assert_allclose(motion, expected, atol=1e-12)
    assert (cube.complex_amplitude_mm[0].imag == 0).all()  # no phase is invented


GAUGE = '[gauges.bed]\nrole = "table"\namplitude_mm = 1.6\nsd_amplitude_mm = 0.008\n'


def test_transmissibility_takes_the_table_as_set_or_as_a_gauge_saw_it(folder: Path):
    path = folder / "captures" / "five" / "capture.toml"
    path.write_text(path.read_text(encoding="utf-8") + GAUGE, encoding="utf-8")
    cube = EnvelopeCube.of(read_results(folder))
    ratio, sd = cube.scalars["transmissibility"], cube.scalars["sd_transmissibility"]
    size = cube.scalars["amplitude_mm"]
    assert cube.per_capture["excitation_amplitude_mm"][0] == 2.0
    np.testing.assert_allclose(ratio[0], size[0] / 1.6)
    np.testing.assert_allclose(sd[0], np.hypot(cube.scalars["sd_amplitude_mm"][0] / 1.6, 0.005 * ratio[0]))
    np.testing.assert_allclose(ratio[1], size[1])
    assert np.isnan(ratio[2, 1])


def test_a_target_that_rides_the_table_has_a_response_of_one(folder: Path):
    """The table moves 0.7 rad before the excitation's reference, and so does the target."""
    path = folder / "captures" / "eight-2" / "capture.toml"
    gauge = GAUGE + "phase_rad = 0.7\nsd_phase_rad = 0.01\n"
    path.write_text(path.read_text(encoding="utf-8") + gauge, encoding="utf-8")
    cube = EnvelopeCube.of(read_results(folder))
    cube.vectors["a_mm"][1, 0], cube.vectors["b_mm"][1, 0] = (
        1.6 * f(0.7) * np.array([1.0, 0, 0]) for f in (np.cos, np.sin)
    )
    np.testing.assert_allclose(cube.frequency_response[1, 0], [1.0, 0.0, 0.0], atol=1e-12)
