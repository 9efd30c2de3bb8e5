from __future__ import annotations

import signal

import pytest

from labdaemon.service.signals import ending_signals, exit_status, name_of


def test_every_signal_that_ends_a_process_and_can_be_caught_is_there():
    by_default_ends_or_dumps = {
        signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM,
        signal.SIGVTALRM, signal.SIGPROF, signal.SIGIO, signal.SIGPWR, signal.SIGXCPU, signal.SIGTRAP, signal.SIGSYS,
        signal.SIGRTMIN, signal.SIGRTMAX,
    }  # fmt: skip
    assert by_default_ends_or_dumps <= set(ending_signals())


def test_what_ends_nothing_or_cannot_be_trusted_is_left_alone():
    left = {signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGABRT, signal.SIGCHLD, signal.SIGWINCH}
    assert not left & set(ending_signals())


@pytest.mark.parametrize(("number", "stays"), [(signal.SIGHUP, False), (signal.SIGINT, True), (signal.SIGTERM, True)])
def test_what_nohup_ignores_stays_ignored(number, stays):
    before = signal.signal(number, signal.SIG_IGN)
    try:
        assert (number in ending_signals()) == stays
    finally:
        signal.signal(number, before)


def test_exit_status_and_names():
    assert [exit_status(n) for n in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)] == [0, 130, 129]
    assert name_of(signal.SIGUSR1) == "SIGUSR1"
    assert name_of(signal.SIGRTMIN + 2) == f"real-time signal {signal.SIGRTMIN + 2}"
