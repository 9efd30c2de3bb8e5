"""`labdaemon process` as a person runs it, on a small rendered folder."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from labdaemon.cli.main import main
from labdaemon.processing.result_reader import read_csv
from labdrivers.sim.folder import make_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_folder(tmp_path_factory.mktemp("set") / "set", seed=51, cameras=1, targets=4)


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["labdaemon", "process", *(str(argument) for argument in arguments)])
    with pytest.raises(SystemExit) as left:
        main()
    return int(left.value.code or 0)


def test_results_pictures_and_a_summary(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    before = sorted(folder.rglob("*"))
    assert run(monkeypatch, folder, "--out", out, "--workers", 1) == 0
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*.*")) == [
        "envelope.csv",
        "measurements.csv",
        "overlay/c1-front.png",
    ]
    assert [row["target"] for row in read_csv(out / "envelope.csv")] == ["T01", "T02", "T03", "T04"]
    said = capsys.readouterr()
    assert "c1" in said.out
    assert f"results in {out}" in said.out
    assert sorted(folder.rglob("*")) == before


@pytest.mark.slow
def test_the_published_method_gives_rows_too(monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path) -> None:
    assert run(monkeypatch, folder, "--out", tmp_path, "--method", "paper", "--no-overlay") == 0
    rows = read_csv(tmp_path / "envelope.csv")
    assert len(rows) == 4
    assert not (tmp_path / "overlay").exists()


def test_bad_input_exits_2_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(monkeypatch, tmp_path / "nowhere", "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err.strip()
    assert "nowhere" in said
    assert "\n" not in said
    assert run(monkeypatch, tmp_path, "--out", tmp_path / "out") == 2
    assert "is no data-set folder: it has no rig.toml" in capsys.readouterr().err
    assert run(monkeypatch, tmp_path, "--method", "guess") == 2
    assert not (tmp_path / "out").exists()
