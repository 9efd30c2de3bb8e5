from __future__ import annotations

import logging
import os
import sys
import threading

import pytest

from labdaemon.imaging.library_output import captured_stderr


def test_what_c_code_prints_is_caught_and_judged(capfd: pytest.CaptureFixture[str]) -> None:
    with captured_stderr() as printed:
        os.write(2, b"a.dng: data corrupted at 1234\n")
    assert printed.text == "a.dng: data corrupted at 1234\n"
    assert printed.reports_damage
    with captured_stderr() as printed:
        os.write(2, b"libpng warning: nothing serious\n")
    assert not printed.reports_damage
    print("afterwards", file=sys.stderr)
    assert capfd.readouterr().err == "afterwards\n"


def test_descriptor_2_comes_back_after_an_exception(capfd: pytest.CaptureFixture[str]) -> None:
    def fail() -> None:
        os.write(2, b"libpng error: bad\n")
        raise KeyError

    with pytest.raises(KeyError), captured_stderr() as printed:
        fail()
    assert printed.reports_damage
    os.write(2, b"seen\n")
    assert capfd.readouterr().err == "seen\n"


def test_other_threads_lines_are_passed_on(capfd: pytest.CaptureFixture[str]) -> None:
    done, go = threading.Event(), threading.Event()

    def work() -> None:
        os.write(2, b"a thread's own line\n")
        done.set()
        go.wait(10)

    thread = threading.Thread(target=work)
    with captured_stderr() as printed:
        thread.start()
        assert done.wait(10)
        os.write(2, b"a.dng: Unexpected end of file\n")
    go.set()
    thread.join()
    assert printed.reports_damage
    assert capfd.readouterr().err == "a thread's own line\n"


def test_tifffile_s_log_does_not_reach_the_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    logging.getLogger("tifffile").error("<tifffile.TiffPages @8> invalid page offset")
    assert "invalid page offset" not in capfd.readouterr().err
