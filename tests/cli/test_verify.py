"""`labdaemon verify` and `labdaemon noise-floor` as a person runs them, on a small rendered folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from labdaemon.cli.export import export
from labdaemon.cli.verify import noise_floor_command, verify
from labdaemon.errors import UsageError
from labdaemon.processing import WorkerPool, process_folder
from labdrivers.sim.folder import make_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make_folder(tmp_path_factory.mktemp("set") / "set", seed=51, cameras=1, targets=3)
    with WorkerPool(1) as pool:
        process_folder(made, pool=pool)
    return made


def run(*arguments: object) -> Result:
    return CliRunner().invoke(verify, [str(one) for one in arguments], catch_exceptions=False, standalone_mode=False)


def test_a_folder_that_was_not_touched_gives_the_same_files_and_numbers(folder: Path):
    CliRunner().invoke(export, [str(folder), "--to", str(folder / "ro-crate-metadata.json")], catch_exceptions=False)
    done = run(folder, "--workers", 1)
    lines = done.output.splitlines()
    assert lines[0].endswith("files compared with ro-crate-metadata.json: all the same")
    assert lines[1] == "6 rows measured again: all the same"
    assert done.return_value == 0


def test_a_changed_number_and_a_changed_file_are_named(folder: Path, tmp_path: Path):
    results = tmp_path / "results"
    results.mkdir()
    for name in ("envelope.csv", "measurements.csv"):
        text = (folder / "results" / name).read_text(encoding="utf-8")
        (results / name).write_text(text.replace(",T02,1", ",T02,2", 1), encoding="utf-8")
    rig = folder / "rig.toml"
    before = rig.read_text(encoding="utf-8")
    try:
        rig.write_text(before + "\n# a remark\n", encoding="utf-8")
        done = run(folder, "--results", results, "--workers", 1)
    finally:
        rig.write_text(before, encoding="utf-8")
    assert "rig.toml has another content than ro-crate-metadata.json recorded" in done.output
    assert "T02: x_" in done.output
    assert done.return_value == 1


def test_one_capture_is_too_few_for_a_noise_floor(folder: Path):
    with pytest.raises(UsageError, match="needs 2 captures"):
        CliRunner().invoke(noise_floor_command, [str(folder)], catch_exceptions=False)
