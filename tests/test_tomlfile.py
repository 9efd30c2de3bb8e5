"""Files that people and peers write: refused in one line, within a moment, whatever they hold."""

from __future__ import annotations

import os
import threading
import time
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdaemon.errors import ConfigError
from labdaemon.toml_limits import check_toml
from labdaemon.tomlfile import MAX_BYTES, parse_toml, read_toml

BOMBS = {
    "dotted key": "a" + ".a" * 50_000 + " = 1\n",
    "spaced dotted key": "a" + " . a" * 50_000 + " = 1\n",
    "quoted dotted key": '"a"' + '."a"' * 50_000 + " = 1\n",
    "table head": "[a" + ".a" * 50_000 + "]\n",
    "array of tables": "[[a" + ".a" * 50_000 + "]]\n",
    "dotted key in an inline table": "x = { a" + ".a" * 50_000 + " = 1 }\n",
    "dots after a string with a quote": 'x = "\\""\na' + ".a" * 50_000 + " = 1\n",
    "dots after a multi-line string": 'x = """\n"" # [ """\na' + ".a" * 50_000 + " = 1\n",
    "digits": "x = " + "9" * 5000 + "\n",
    "hexadecimal digits": "x = 0x" + "f" * 500_000 + "\n",
    "digits of a float": "x = 0." + "9" * 500_000 + "\n",
    "exponent": "x = 1e" + "9" * 5000 + "\n",
    "digits in an array": "x = [" + "9" * 5000 + "]\n",
    "arrays": "x = " + "[" * 5000 + "]" * 5000 + "\n",
    "inline tables": "x = " + "{a=" * 5000 + "1" + "}" * 5000 + "\n",
    "keys": "".join(f"k{n}=1\n" for n in range(100_000)),
    "table heads": "".join(f"[t{n}]\n" for n in range(150_000)),
    "arrays of tables": "[[t]]\n" * 150_000,
    "size": "# " + "x" * MAX_BYTES,
    "lone surrogate": "x = '\ud800'\n",
    "surrogate escape": 'x = "\\ud800"\n',
    "nothing but an open string": '"' + "\\" * 100_000,
}


def test_a_byte_order_mark_does_no_harm(tmp_path: Path):
    (tmp_path / "rig.toml").write_text("a = 1\n", encoding="utf-8-sig")
    assert read_toml(tmp_path / "rig.toml")[1] == {"a": 1}


@pytest.mark.parametrize("text", BOMBS.values(), ids=BOMBS)
def test_bombs_are_refused_at_once(text: str):
    began = time.process_time()
    with pytest.raises(ConfigError) as caught:
        parse_toml(text, source="campaign")
    assert time.process_time() - began < 5.0
    assert len(str(caught.value)) < 400
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "a.b.c.d = 1.5\nx = [1.5, 2.5, 3.5]\n",
        f"x = '{'.' * 100_000}'\n",
        f'x = """{"[" * 100_000}"""\n',
        f"# {'.' * 1000} {'[' * 1000} {'9' * 1000}\nx = 1979-05-27T07:32:00.999999Z\n",
        f"x = [{'0.1, ' * 10_000}]\n",
        f'notes = "{"9" * 9000}"\n',
        'x = """""""" \n'.replace('""""""""', '"""a"""""'),
        "x = [{ a = 1 }, { b = [[1, 2], [3, 4]] }]\n",
    ],
)
def test_what_a_person_writes_passes(text: str):
    assert parse_toml(text) == tomllib.loads(text)


def test_the_rig_and_campaigns_that_come_along_pass():
    root = Path(__file__).parents[1] / "config"
    for path in root.rglob("*.toml"):
        assert read_toml(path)[1]


@given(st.text(alphabet="a.[]{}=\"'#\\\n 9", max_size=60))
def test_short_text_is_never_refused_for_its_size(text: str):
    nested = max(text.count("["), text.count("{"), text.count(".")) > 15
    if not nested:
        check_toml(text)


def test_a_pipe_is_read_and_one_that_says_nothing_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("labdaemon.tomlfile.PIPE_S", 0.3)
    fifo = tmp_path / "pipe"
    os.mkfifo(fifo)
    keep = os.open(fifo, os.O_RDWR)  # a writer that says nothing
    with pytest.raises(ConfigError, match="nothing came"):
        read_toml(fifo)
    os.close(keep)
    monkeypatch.setattr("labdaemon.tomlfile.PIPE_S", 20.0)

    def write() -> None:
        with fifo.open("w") as file:  # waits until there is a reader
            file.write("x = 1\n")

    writer = threading.Thread(target=write)
    writer.start()
    assert read_toml(fifo)[1] == {"x": 1}
    writer.join()


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null/x", "/", "no\0name", "/proc/self/mem"])
def test_what_is_no_file_is_refused(path: str):
    with pytest.raises(ConfigError):
        read_toml(Path(path))
