"""The programme's plumbing on frames small enough for a test; its figures are for the command to print."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from labdaemon.bench import accuracy, simulator
from labdaemon.bench.accuracy_text import document, lines
from labdaemon.bench.cases import AccuracyCase, cases
from labdaemon.bench.chart import draw
from labdaemon.cli.bench import bench
from labdaemon.errors import UsageError

TINY = {"size": "small", "targets": 6, "amplitude_mm": (0.5, 2.0), "diameters_mm": (8.0, 12.0)}


@pytest.fixture
def tiny_programme(monkeypatch: pytest.MonkeyPatch) -> None:
    programme = [
        AccuracyCase("pooled", "pooled", TINY, pooled=True),
        AccuracyCase("phase", "phase", {**TINY, "exposure_s": 1.1, "phase_rad": (0.0, 1.5708)}),
        AccuracyCase("part-unknown", "part cycles", {**TINY, "exposure_s": 1.074, "tell": "window"}),
    ]
    monkeypatch.setattr(accuracy, "cases", lambda quick: programme)


@pytest.mark.slow
def test_a_small_programme_from_frames_to_figures(tiny_programme: None, tmp_path: Path) -> None:
    reported: list[str] = []
    result = accuracy.run_accuracy((2,), quick=True, keep=tmp_path / "kept", workers=1, report=reported.append)
    assert reported == ["seed 2: pooled", "seed 2: phase", "seed 2: part cycles"]
    assert (tmp_path / "kept" / "pooled-2" / "truth.csv").exists()
    by_key = {case.case.key: case for case in result.cases}
    for case in result.cases:
        assert len(case.ours) == 6
        assert sum(pair.compared for pair in case.ours) >= 3
    assert all(abs(pair.error_mm) < 0.05 for pair in by_key["pooled"].ours if pair.compared)
    assert all("part_cycles" in pair.flags for pair in by_key["part-unknown"].ours)
    text = "\n".join(lines(result))
    assert "-0.115" in text
    assert "Cramér–Rao" in text
    assert "median error" in text
    made = json.loads(json.dumps(document(result), allow_nan=False))
    assert made["cases"]["pooled"]["figures"]["targets"] == 6
    assert made["cases"]["phase"]["median_phase_error_deg"] < 10.0
    draw(result, tmp_path / "figure" / "accuracy.png")
    assert (tmp_path / "figure" / "accuracy.png").read_bytes()[:4] == b"\x89PNG"


def test_the_programme_covers_what_is_claimed() -> None:
    keys = {case.key for case in cases(False)}
    assert keys >= {"pooled", "orbit", "phase", "part-known", "part-unknown", "gaussian", "dim", "clipped", "noisy"}
    assert {case.key for case in cases(True)} < keys
    pooled = next(case for case in cases(False) if case.pooled)
    assert pooled.folder_options(7)["seed"] == 7
    assert pooled.paper


def test_without_a_simulator_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulator, "entry_points", lambda **_: ())
    with pytest.raises(UsageError, match="no simulator"):
        accuracy.run_accuracy((1,), quick=True)


def test_an_unknown_case_is_refused_by_name() -> None:
    answer = CliRunner().invoke(bench, ["accuracy", "--only", "pooled", "--only", "cheese"])
    assert answer.exit_code == 2
    assert "cheese" in answer.output
    assert "part-known" in answer.output
