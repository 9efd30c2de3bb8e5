"""[shaker] and [trigger] cut out of a rig file, whatever else is wrong with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.errors import ConfigError
from labdaemon.service.stop_actuators import cut_sections, read_stop_actuators

RIG = """
[service]
data = "data"
[shaker]
driver = "scpi"
port = "socket://127.0.0.1:4001"
drive = [
    { frequency_hz = 5.0, mm_per_v = 2.0 },
    { frequency_hz = 9.0, mm_per_v = 1.0 },
]
[shaker.limits]
stroke_mm = 150.0
velocity_mm_s = 1000.0
acceleration_mm_s2 = 20000.0
frequency_hz = [0.5, 50.0]
[trigger]
driver = "box"
port = "socket://127.0.0.1:4002"
[cameras.left]
driver = "ptp"
serial = "1"
"""


def rig(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "rig.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    "slip",
    [
        lambda text: text,
        lambda text: text + "colour = \n",
        lambda text: text + "[cameras.left]\n",
        lambda text: text + '[targets]\nname = """never ended\n',
        lambda text: "]]]\n" + text,
        lambda text: "[service\n" + text,
        lambda text: text.replace('serial = "1"', 'serial = "1'),
        lambda text: text.replace('driver = "ptp"', 'driver = "ptpx"'),
        lambda text: text + "[nonsense]\nx = 1\n",
        lambda text: text.encode() + b"# \xff\xfe\n",
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
    ],
)
def test_a_slip_elsewhere_does_not_matter(tmp_path: Path, slip):
    stop_actuators = read_stop_actuators(rig(tmp_path, slip(RIG)))
    assert stop_actuators.port == "socket://127.0.0.1:4001"
    assert stop_actuators.rig.shaker is not None
    assert stop_actuators.rig.trigger is not None
    assert stop_actuators.troubles == ()


@pytest.mark.parametrize(
    "slip",
    [
        lambda text: text.replace("stroke_mm = 150.0", "stroke_mm = 150,0"),
        lambda text: text.replace('driver = "scpi"', 'driver = "scpy"'),
        lambda text: text.replace('driver = "scpi"', 'driver = "scpi"\ncolour = 3'),
        lambda text: text.replace("mm_per_v = 2.0", "mm_per_v = -2.0"),
        lambda text: text.replace('driver = "scpi"', 'driver = "scpi"\ncalibration = "gone.csv"'),
        lambda text: text.replace('driver = "scpi"', 'driver = "scpi"\ncommands = { set_level = "VOLT" }'),
        lambda text: text.replace('driver = "scpi"', 'driver = "scpi"\nbaudrate = "fast"'),
        lambda text: text.replace("    { frequency_hz = 9.0, mm_per_v = 1.0 },\n]", "    { frequency_hz = 9.0"),
    ],
)
def test_what_of_the_shaker_s_own_section_can_be_read_is_enough_to_stop_it(tmp_path: Path, slip):
    stop_actuators = read_stop_actuators(rig(tmp_path, slip(RIG)))
    assert stop_actuators.port == "socket://127.0.0.1:4001"
    assert stop_actuators.rig.shaker is not None
    assert stop_actuators.rig.trigger is not None


def test_without_the_shaker_s_port_the_trigger_is_left_and_it_says_so(tmp_path: Path):
    stop_actuators = read_stop_actuators(
        rig(tmp_path, RIG.replace('port = "socket://127.0.0.1:4001"', "port = socket"))
    )
    assert stop_actuators.rig.shaker is None
    assert stop_actuators.rig.trigger is not None
    assert not stop_actuators.is_without_shaker
    assert any("port = socket" in trouble for trouble in stop_actuators.troubles)


def test_a_rig_without_shaker_is_one_only_where_the_file_can_be_read(tmp_path: Path):
    without = '[cameras.left]\ndriver = "ptp"\n'
    assert read_stop_actuators(rig(tmp_path, without)).is_without_shaker
    assert not read_stop_actuators(rig(tmp_path, without + "x =\n")).is_without_shaker


def test_dotted_keys_and_inline_tables_count_too():
    sections, is_whole, _ = cut_sections('shaker = { driver = "scpi", port = "a" }\ntrigger.driver = "box"\nx =\n')
    assert sections == {"shaker": {"driver": "scpi", "port": "a"}, "trigger": {"driver": "box"}}
    assert not is_whole


def test_a_file_that_is_not_there_is_said(tmp_path: Path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_stop_actuators(tmp_path / "absent.toml")
