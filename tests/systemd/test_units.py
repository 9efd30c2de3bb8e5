from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from labdaemon.cli.main import cli

UNITS = Path(__file__).resolve().parents[2] / "systemd"
SERVICE = UNITS / "labdaemon@.service"


def analyze(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd-analyze is not installed")
    return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)


def settings() -> configparser.SectionProxy:
    parser = configparser.RawConfigParser(strict=False, delimiters=("=",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(SERVICE)
    return parser["Service"]


def test_exposure_is_at_most_two():
    result = analyze("security", "--offline=true", "--threshold=20", SERVICE)
    assert result.returncode == 0, result.stdout[-400:]


def test_the_unit_verifies_in_silence(tmp_path: Path):
    # verify wants the programs to exist, and returns 0 for keys it does not know: only silence counts
    unit = tmp_path / "labdaemon@sim.service"
    unit.write_text(SERVICE.read_text().replace("/usr/bin/labdaemon", "/bin/true"))
    result = analyze("verify", "--man=no", unit)
    assert (result.returncode, result.stderr, result.stdout) == (0, "", "")


def test_a_misspelt_key_would_be_found(tmp_path: Path):
    unit = tmp_path / "labdaemon@sim.service"
    unit.write_text(SERVICE.read_text().replace("/usr/bin/labdaemon", "/bin/true").replace("WatchdogSec", "WatchDog"))
    assert "WatchDog" in analyze("verify", "--man=no", unit).stderr


def test_it_waits_for_ready_is_watched_and_restarted_and_ends_at_rest():
    found = settings()
    assert found["Type"] == "notify"
    assert int(found["WatchdogSec"]) <= 60
    assert found["Restart"] == "on-failure"
    assert found["RestartPreventExitStatus"] == "2"
    assert "safe-stop" in found["ExecStopPost"]


def test_the_guardian_may_finish_when_the_daemon_is_gone():
    found = settings()
    assert found["KillMode"] == "process"  # mixed would kill it as soon as the main process has died
    assert "SendSIGKILL" not in found  # a daemon that hangs at its end is still killed
    assert found["OOMPolicy"] == "continue"


def test_it_is_never_given_up():
    text = SERVICE.read_text()
    assert "\nStartLimitIntervalSec=0\n" in text
    assert "StartLimitBurst" not in text
    assert int(settings()["RestartSec"]) >= 2  # a start that fails at once does not keep the computer busy


@pytest.mark.parametrize("key", ["ExecStart", "ExecStopPost"])
def test_the_commands_exist_with_the_options_that_the_unit_gives(key: str):
    program, command, *arguments = settings()[key].split()
    assert program == "/usr/bin/labdaemon"
    told = CliRunner().invoke(cli, [command, "--help"])
    assert told.exit_code == 0
    for option in (argument for argument in arguments if argument.startswith("--")):
        assert option in told.output


def test_users_can_be_made(tmp_path: Path):
    program = shutil.which("systemd-sysusers")
    if program is None:
        pytest.skip("systemd-sysusers is not installed")
    (tmp_path / "etc").mkdir()
    result = subprocess.run(
        [program, f"--root={tmp_path}", UNITS / "labdaemon.sysusers.conf"], capture_output=True, text=True
    )
    if "Operation not permitted" in result.stderr or "Permission denied" in result.stderr:
        pytest.skip("making users in a folder needs more permission than there is here")
    assert result.returncode == 0, result.stderr
    groups = (tmp_path / "etc" / "group").read_text()
    assert "dialout" in groups
    assert "labdaemon" in (tmp_path / "etc" / "passwd").read_text()


def test_folders_belong_to_the_daemon_alone():
    lines = [line.split() for line in (UNITS / "labdaemon.tmpfiles.conf").read_text().splitlines() if line[:1] == "d"]
    assert {(line[1], line[2], line[3]) for line in lines} == {
        ("/etc/labdaemon", "0750", "root"),
        ("/var/lib/labdaemon", "0750", "labdaemon"),
    }


def test_each_file_is_named_where_a_person_reads_how_to_install():
    guide = (UNITS.parent / "docs" / "how-to" / "install-for-a-night.md").read_text()
    assert set(re.findall(r"cp systemd/([\w@.-]+\w)", guide)) == {path.name for path in UNITS.iterdir()}


def test_cameras_are_given_to_the_group_that_the_unit_joins():
    [rule] = [line for line in (UNITS / "60-labdaemon-cameras.rules").read_text().splitlines() if line[0] != "#"]
    keys = dict(re.findall(r'(\w+(?:\{\w+\})?)=+"([^"]*)"', rule))
    assert keys["GROUP"] in settings()["SupplementaryGroups"].split()
    assert keys["ENV{ID_USB_INTERFACES}"].strip("*") == ":060101:"  # still image, PTP
