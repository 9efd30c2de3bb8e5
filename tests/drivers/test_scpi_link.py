"""Questions and answers in step: whose answer it is."""

from __future__ import annotations

import pytest

from labdaemon.errors import ProtocolError
from labdrivers.scpi_commands import ScpiCommands
from labdrivers.scpi_link import ScpiLink
from labdrivers.serial_line import PortSettings, SerialLine
from labdrivers.sim.wire import TcpPort, WireDevice

IDENTITY = "KEYSIGHT,33500"


class Late(WireDevice):
    """A controller that is on, behind a wire on which answers to an earlier program have not arrived yet."""

    def __init__(self, late: list[str]) -> None:
        super().__init__()
        self.late, self.rest = late, b""

    def receive(self, data: bytes) -> None:
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in lines:
            if line == b"*IDN?" and self.late:
                self.send("".join(f"{answer}\n" for answer in self.late).encode())
                self.late = []
            if line == b"*IDN?":
                self.send(f"{IDENTITY}\n".encode())
            elif line == b"OUTP?":
                self.send(b"1\n")


@pytest.fixture
def link_to():
    opened = []

    def make(device: Late) -> ScpiLink:
        port = TcpPort(device)
        line = SerialLine("shaker", PortSettings(port=port.url, timeout_s=20.0))
        line.open()
        opened.extend((line, port))
        return ScpiLink(line, ScpiCommands())

    yield make
    for one in opened:
        one.close()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_late_answers_are_no_identity(link_to, count):
    link = link_to(Late(["0"] * count))
    assert link.identify() == IDENTITY
    assert link.query_switch("OUTP?")


@pytest.mark.parametrize("late", [["0"] * 8, [IDENTITY, IDENTITY, "0"], ["0", IDENTITY, IDENTITY, "0", "0"]])
def test_a_row_of_late_answers_never_says_that_the_output_is_off(link_to, late):
    link = link_to(Late(late))
    try:
        link.identify()
    except ProtocolError:
        link.identify()  # what was late has come by now
    assert link.query_switch("OUTP?")


def test_coming_back_into_step_a_late_identity_is_not_the_last_answer(link_to):
    """Two questions had no answer in time, and both come later: who it is, and that the output was off then."""
    device = Late([])
    link = link_to(device)
    link.identify()
    device.send(b"what?\n")  # no switch's answer: the link asks for the identity before it asks again
    device.late = [IDENTITY, "0"]
    assert link.query_switch("OUTP?")
