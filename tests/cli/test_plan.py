"""`labdaemon plan` on the simulated rig's file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from labdaemon.cli.plan import plan
from labdaemon.errors import LimitError, UsageError

CONFIG = Path(__file__).parents[2] / "config"
ARGS = ["--config", str(CONFIG / "sim.toml")]
THREE_MODES = CONFIG / "campaigns" / "three-modes.toml"


def test_every_step_has_a_line_and_the_totals_follow() -> None:
    result = CliRunner().invoke(plan, [str(THREE_MODES), *ARGS], catch_exceptions=False)
    lines = result.output.splitlines()
    assert len(lines) == 6
    assert lines[2].split() == ["00001-steps-5.000hz", "5.000", "2", "62.83", "1974", "1", "1", "5.00", "0:28", "10%"]
    assert lines[-1].startswith("4 steps, 6 captures, about 1:15, 0.24 GB of ")


def test_json_has_the_same_steps() -> None:
    document = json.loads(CliRunner().invoke(plan, [str(THREE_MODES), *ARGS, "--json"]).output)
    assert [step["frequency_hz"] for step in document["steps"]] == [None, 5.0, 8.0, 12.0]
    assert document["predicted_bytes"] == sum(step["predicted_bytes"] for step in document["steps"])


def test_a_step_beyond_the_limits_ends_it(tmp_path: Path) -> None:
    (tmp_path / "far.toml").write_text(THREE_MODES.read_text().replace("0.5]", "20.0]"))
    with pytest.raises(LimitError, match=r"far.toml: phase\[1\].amplitude_mm\[2\]: .* acceleration"):
        CliRunner().invoke(plan, [str(tmp_path / "far.toml"), *ARGS], catch_exceptions=False)


def test_without_a_rig_file_the_simulated_one_is_taken_and_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(CONFIG.parent)
    result = CliRunner().invoke(plan, [str(THREE_MODES), "--address", "tcp://127.0.0.1:9"])
    assert result.stderr == "planned for config/sim.toml\n"
    assert len(result.stdout.splitlines()) == 6
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="--config"):
        CliRunner().invoke(plan, [str(THREE_MODES), "--address", "tcp://127.0.0.1:9"], catch_exceptions=False)


def test_the_plan_says_what_stands_for_the_enable_line(tmp_path: Path) -> None:
    rig = (CONFIG / "sim.toml").read_text()
    folder = tmp_path / "config"
    folder.mkdir()
    for file in CONFIG.glob("sim-*.csv"):
        (folder / file.name).write_text(file.read_text())
    blind = rig.replace('role = "table"', 'role = "response"')
    accepted = blind.replace("[interlocks]\n", "[interlocks]\naccept_no_enable = true\n")
    said = []
    for text in (rig, blind, accepted):
        (folder / "rig.toml").write_text(text)
        result = CliRunner().invoke(plan, [str(THREE_MODES), "--config", str(folder / "rig.toml")])
        assert result.exit_code == 0, result.output
        said.append(result.output.splitlines()[-1])
    assert "proven before the table moves" in said[0]
    assert "`submit` refuses" in said[1]
    assert "accepted by accept_no_enable" in said[2]
