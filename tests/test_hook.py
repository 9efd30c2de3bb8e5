from __future__ import annotations

import sys
import time

import pytest

from labdaemon.hook import HookError, run_hook


def python(source: str) -> list[str]:
    return [sys.executable, "-c", source]


@pytest.mark.parametrize(
    "output", [b"relais \xe9teint", b"\xff\xfe\x00\x00", b"", b"\0\0\0", b"\xed\xa0\x80", b"\x1b[31mred\r\n"]
)
def test_output_in_no_encoding_does_no_harm(output: bytes):
    result = run_hook(python(f"import os; os.write(1, {output!r}); os.write(2, {output!r})"), 60.0)
    assert result.status == 0
    assert result.last_line == "" or result.last_line.isprintable()


def test_the_last_line_of_a_flood_is_kept():
    flood = "import sys; print('x' * 9_000_000); print('no such port'); sys.exit(3)"
    result = run_hook(python(flood), 60.0)
    assert (result.status, result.last_line) == (3, "no such port")


def test_a_child_that_keeps_the_pipe_open_is_not_waited_for():
    leave = (
        "import subprocess, sys; subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(40)']); print('on')"
    )
    began = time.monotonic()
    assert run_hook(python(leave), 60.0).last_line == "on"
    assert time.monotonic() - began < 35.0


@pytest.mark.parametrize("command", [["/no/such/relay"], ["a\0b"], [""], ["\ud800"]])
def test_a_command_that_cannot_be_started(command: list[str]):
    with pytest.raises(HookError):
        run_hook(command, 5.0)


def test_a_command_that_does_not_end_is_killed():
    with pytest.raises(HookError, match=r"does not end within 0\.3 s"):
        run_hook(python("import time; time.sleep(60)"), 0.3)


@pytest.mark.parametrize("source", ["", "import sys; sys.stdin.read(10)", "import sys; sys.stdin.close()"])
def test_a_command_that_does_not_read_its_input_has_not_failed(source: str):
    assert run_hook(python(source), 60.0, b"x" * 1_000_000).status == 0


def test_the_deadline_holds_while_a_command_ignores_a_large_input():
    began = time.monotonic()
    with pytest.raises(HookError, match="does not end"):
        run_hook(python("import time; time.sleep(60)"), 0.5, b"x" * 1_000_000)
    assert time.monotonic() - began < 20.0


def test_what_is_written_is_read_to_its_end():
    done = run_hook(python("import sys; text = sys.stdin.read(); print(len(text))"), 60.0, b"x" * 300_000)
    assert done.last_line == "300000"
