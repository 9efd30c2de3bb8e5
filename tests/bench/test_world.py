from __future__ import annotations

import json

from click.testing import CliRunner

from labdaemon.bench.world import command as world
from labdaemon.bench.world.row import WorldOptions, WorldRow, table_of
from labdaemon.bench.world.sections import SECTIONS, section


def test_every_section_can_be_imported_and_is_a_function_of_the_options():
    for name in SECTIONS:
        assert callable(section(name))


def test_the_table_and_the_exit_status_report_what_does_not_hold(monkeypatch):
    seen = []

    def rows(options: WorldOptions):
        seen.append(options)
        yield WorldRow("endings", "SIGKILL", 2, "at rest after 0.31 s", "<= 2 s", True)
        yield WorldRow("endings", "a|b", 2, "at rest after 3.00 s", "<= 2 s", False)

    monkeypatch.setattr(world, "section", lambda name: rows)
    done = CliRunner().invoke(world.command, ["--section", "endings", "--quick", "--seed", "7", "--json"])
    assert done.exit_code == 1
    assert seen == [WorldOptions(quick=True, seed=7, soak_minutes=1.0)]
    assert [row["holds"] for row in json.loads(done.stdout)] == [True, False]
    assert (
        table_of(rows(WorldOptions())).splitlines()[-1] == "| endings | a/b | 2 | at rest after 3.00 s | <= 2 s | NO |"
    )
