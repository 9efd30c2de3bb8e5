"""`labdaemon plan --optimise`: the table, the TOML, and what is written."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.cli.optimise_plan import campaign_toml
from labdaemon.cli.plan import plan
from labdaemon.errors import LimitError, UsageError

CONFIG = Path(__file__).parents[2] / "config"
CAMPAIGN = """
name = "short"
[[phase]]
kind = "sharp"
frames = 2
[[phase]]
kind = "steps"
frequency_hz = [5.0, 8.0]
amplitude_mm = 0.5
captures = 2
label = "modes"
settle = { timeout_s = 30.0 }
[[phase]]
kind = "pause"
duration_s = 5.0
"""


def invoke(*args: object) -> Result:
    return CliRunner().invoke(plan, [str(arg) for arg in args], catch_exceptions=False)


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """A campaign that was optimised for amplitude, and what was printed."""
    path = tmp_path_factory.mktemp("plan") / "short.toml"
    path.write_text(CAMPAIGN)
    options = ("--config", CONFIG / "sim.toml", "--optimise", "--goal", "amplitude", "--expected-mm", 1, 1, "--json")
    return path, invoke(path, *options, "--out", path.with_name("best.toml"))


def test_json_has_both_predictions_and_the_campaign(asked: tuple[Path, Result]) -> None:
    found = json.loads(asked[1].stdout)
    assert [one["frequency_hz"] for one in found["designs"]] == [5.0, 8.0]
    for one in found["designs"]:
        assert one["best"]["sd_amplitude_mm"] <= 1.001 * one["now"]["sd_amplitude_mm"]
        assert one["now"]["captures"] == 2
    assert tomllib.loads(found["toml"])["name"] == "short"


def test_what_is_written_plans_and_keeps_the_rest(asked: tuple[Path, Result]) -> None:
    path, _ = asked
    phases: list[dict[str, Any]] = tomllib.loads(path.with_name("best.toml").read_text())["phase"]
    assert [phase["kind"] for phase in phases] == ["sharp", "steps", "steps", "pause"]
    assert [phase.get("frequency_hz") for phase in phases] == [None, 5.0, 8.0, None]
    assert phases[1]["label"] == "modes"
    assert phases[1]["settle"] == {"timeout_s": 30.0}
    assert phases[1]["captures"] >= 2
    assert path.read_text() == CAMPAIGN
    assert "8.000hz" in invoke(path.with_name("best.toml"), "--config", CONFIG / "sim.toml").stdout


def test_a_campaign_without_designs_comes_back_as_it_is() -> None:
    read = load_campaign(CAMPAIGN)
    assert tomllib.loads(campaign_toml(read, [])) == tomllib.loads(CAMPAIGN)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--goal", "phase"), "belong to --optimise"),
        (("--write",), "belong to --optimise"),
        (("--optimise", "--expected-mm", 3, 1), "least value comes first"),
        (("--optimise", "--expected-mm", "nan", "nan"), "least value comes first"),
        (("--optimise", "--expected-mm", 1, 2, "--transmissibility", 1, 2), "say the same"),
        (("--optimise", "--expected-mm", 500, 1000), "200 at most are looked at"),
    ],
)
def test_options_that_make_no_sense_are_refused(tmp_path: Path, options: tuple[object, ...], words: str) -> None:
    path = tmp_path / "c.toml"
    path.write_text(CAMPAIGN)
    with pytest.raises(UsageError, match=words):
        invoke(path, "--config", CONFIG / "sim.toml", *options)


def test_a_table_that_does_not_move_and_part_cycles_without_a_phase_have_no_prediction(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    still = CAMPAIGN.replace("amplitude_mm = 0.5", "amplitude_mm = 0.0")
    path.write_text(still)
    with pytest.raises(UsageError, match=r"phase\[1\].amplitude_mm is 0"):
        invoke(path, "--config", CONFIG / "sim.toml", "--optimise")
    path.write_text(CAMPAIGN.replace("[5.0, 8.0]", "2.0").replace("captures = 2", "exposure_s = 0.1"))
    done = invoke(path, "--config", CONFIG / "sim.toml", "--optimise", "--expected-mm", 1, 1)
    assert "part_cycles" in next(line for line in done.stdout.splitlines() if " now " in line)


def test_a_campaign_that_cannot_run_is_refused_before_anything_is_searched(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(CAMPAIGN.replace("amplitude_mm = 0.5", "amplitude_mm = 90.0"))
    with pytest.raises(LimitError, match=r"phase\[1\].amplitude_mm"):
        invoke(path, "--config", CONFIG / "sim.toml", "--optimise")
    path.write_text('name = "x"\n[[phase]]\nkind = "sharp"\n')
    with pytest.raises(UsageError, match="nothing to choose"):
        invoke(path, "--config", CONFIG / "sim.toml", "--optimise")
