from __future__ import annotations

import threading

import pytest

from labdaemon.guardian import rescue as module
from labdaemon.guardian.recipe import PortSetup, StopRecipe
from labdaemon.guardian.rescue import rescue
from labdaemon.guardian.wire import StopFailure

RECIPE = StopRecipe("shaker", "/dev/ttyUSB0", PortSetup(), (), None, ())


class Log:
    def __init__(self):
        self.lines = []

    def say(self, text):
        self.lines.append(text)


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    monkeypatch.setattr(module, "FIRST_PAUSE_S", 0.001)
    monkeypatch.setattr(module, "LONGEST_PAUSE_S", 0.01)


def test_it_tries_until_the_table_is_seen_at_rest_and_names_the_emergency_stop_meanwhile():
    troubles = [StopFailure("no answer"), RuntimeError("what no one foresaw"), None]
    log = Log()

    def stop(_):
        if (trouble := troubles.pop(0)) is not None:
            raise trouble

    outcome = rescue(RECIPE, log, patience_s=60.0, is_wanted=lambda: False, stop=stop)
    assert (outcome.is_at_rest, outcome.tries, outcome.trouble) == (True, 3, "RuntimeError: what no one foresaw")
    [line] = log.lines
    assert "emergency stop" in line
    assert "no answer" in line


def test_it_ends_when_its_patience_does_and_says_so():
    def stop(_):
        raise StopFailure("port does not open")

    outcome = rescue(RECIPE, Log(), patience_s=0.05, is_wanted=lambda: False, stop=stop)
    assert not outcome.is_at_rest
    assert outcome.tries > 1


def test_it_leaves_the_table_to_a_newer_daemon_but_not_at_once(monkeypatch):
    monkeypatch.setattr(module, "HAND_OVER_S", 0.05)
    tries = []

    def stop(_):
        tries.append(1)
        raise StopFailure("no answer")

    outcome = rescue(RECIPE, Log(), patience_s=60.0, is_wanted=lambda: True, stop=stop)
    assert not outcome.is_at_rest
    assert 0.05 <= outcome.after_s < 30.0
    assert len(tries) > 1


def test_a_try_that_hangs_is_left_and_the_next_one_comes(monkeypatch):
    monkeypatch.setattr(module, "TRY_S", 0.05)
    ended, calls = threading.Event(), []

    def stop(_):
        calls.append(1)
        if len(calls) == 1:
            ended.wait(60.0)

    log = Log()
    outcome = rescue(RECIPE, log, patience_s=60.0, is_wanted=lambda: False, stop=stop)
    ended.set()
    assert (outcome.is_at_rest, outcome.tries) == (True, 2)
    assert "hangs" in log.lines[0]
