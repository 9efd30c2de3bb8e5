r"""The trigger box's line protocol: what goes over its serial wire, both ways.

Every exchange is one request of the host and one reply of the box, each a line of ASCII ended by ``\n``::

    >SEQ VERB ARGUMENTS*CRC        host to box
    <SEQ OK VALUES*CRC             box to host
    <SEQ ERR WORD TEXT*CRC

``SEQ`` is 1 to 65535, chosen by the host, one more each time. ``CRC`` is four hexadecimal digits of CRC-16/XMODEM
(polynomial 1021, start 0; `binascii.crc_hqx`, avr-libc's `_crc_xmodem_update`) over everything between the first
character and the ``*``. The box never speaks unasked, and ignores a line whose checksum is wrong. So rubbish and late
replies cannot be mistaken: a reply counts only with the right checksum *and* the sequence number just sent. A request
that gets no reply is sent again with its number; the box answers a number it has just served with the same reply and
does nothing twice, so a shutter is never fired twice for one command.

Times are whole microseconds of the box's own clock, modulo 2³² (71 minutes): only differences mean anything.

===================  =============================================  =================================================
Request              Reply's values                                 Meaning
===================  =============================================  =================================================
``ID``               ``labtrigger VERSION SERIAL OUTPUTS``          who is there; accepts any sequence number
``NOW``              ``TIME``                                       the box's clock
``EN MS``            ``1``                                          raise the enable line, for MS ms (at most 5000)
``HB MS``            ``0`` or ``1``                                 hold it MS ms more *if it is up*; its state
``DROP``             ``0``                                          drop it now
``FIRE HOLD``        ``N``                                          release all shutters now, for HOLD µs; shot N
``FIRE HOLD DELAY``  ``N``                                          the same DELAY µs after the next sync edge
``ARM HOLD``         ``N``                                          from now on each edge of the external input
                                                                    releases; N is the last shot so far
``DISARM``           ``N``                                          no longer; N is the last shot
``SHOT N``           ``N STATE RELEASE O1..O4 SYNC PERIOD NOW``     what is known of shot N, below
``LAMP``             ``LEVEL LEVELS``                               the lamp's constant light, 0 to 255, and how many
                                                                    levels it can show: 2 where it only switches
``LAMP LEVEL``       ``LEVEL``                                      constant light from now on
``CODE C OPEN T L``  ``PERIOD``                                     arms a light code for the next shot, below
``CODE 0``           ``0``                                          no code for the next shot
``PLAYED N``         ``N STATE START SYNC PERIOD CYCLES NOW``       what became of shot N's code, below
===================  =============================================  =================================================

Of a shot: STATE is WAIT, OPEN (released) or DONE; O1 to O4 the closing of each flash-sync contact; SYNC the last sync
edge before the release, PERIOD the sync's period; ``-`` for what was not seen.
A shot is DONE when all contacts have closed or two seconds have passed since the release. The box remembers eight.

A **light code** is played with the next shot, C whole cycles of the sync input's period. L is the brightness of its
2 to 64 equal sectors, two hexadecimal digits each; T is where in the cycle the first of them begins, in 1/65536 of a
cycle after the sync's edge; OPEN is for how many µs the shutters stay open. The lamp is dark from the release on. The
code begins at the first edge of one of its sectors after the last flash-sync contact has closed, runs on the period
that was measured then, and ends with the same sector: over whole cycles it makes no difference which one is first.
Then the lamp is dark until OPEN is over for all shutters; 0.1 s later the constant light returns.
Of a code: STATE is WAIT, PLAY, DONE, or CUT: not played, or ended early, because a contact did not close, the sync was
lost, changed its period by more than 1 % or drifted away from the code by more than 0.5 % of a cycle, or the code
would have lasted longer than the shutters are open. START is the first edge, SYNC the sync edge before the contacts
closed, PERIOD the one played, CYCLES how many were completed.
A box is switched on with its lamp at full brightness. A box of before the lamp output answers ``SYNTAX`` to all three.

Errors: ``SYNTAX``, ``RANGE``, ``BUSY`` (a shot is in progress), ``NOSYNC`` (no edge of the sync input within two
seconds), ``UNKNOWN`` (no such shot, or no code with it), ``NOLAMP`` (the box has no lamp output).
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass

CLOCK_WRAP = 2**32  # 71 minutes of microseconds
LAST_SEQUENCE = 65535  # sixteen bits, 0 left out
OUTPUTS = 4  # cameras that one box releases
TURN_PARTS = 65536
FULL_LEVEL = 255
LONGEST_HOLD_MS = 5000  # the box refuses more, so that a lost drop ends by itself


@dataclass(frozen=True, slots=True)
class WireMessage:
    """A line that passed its checksum: sequence number and the words after it."""

    sequence: int
    words: tuple[str, ...]


def encode(start: str, sequence: int, text: str) -> bytes:
    """One line: `start` is ``>`` towards the box, ``<`` from it."""
    body = f"{sequence} {text}"
    return f"{start}{body}*{binascii.crc_hqx(body.encode('ascii'), 0):04X}\n".encode("ascii")


def decode(start: str, line: bytes) -> WireMessage | None:
    """The frame in a line (its end removed), None if it is not one or its checksum is wrong."""
    head, separator, check = line.strip().partition(b"*")
    if not separator or not head.startswith(start.encode("ascii")) or len(check) != 4:
        return None
    body = head[1:]
    try:
        if int(check, 16) != binascii.crc_hqx(body, 0):
            return None
        words = body.decode("ascii").split(" ")
        sequence = int(words[0])
    except ValueError:  # no number where the protocol has one: rubbish
        return None
    if not 0 < sequence <= LAST_SEQUENCE:
        return None
    return WireMessage(sequence, tuple(words[1:]))


def elapsed_us(later: int, earlier: int) -> int:
    """Microseconds between two times of the box, either sign, up to half a wrap."""
    return (later - earlier + CLOCK_WRAP // 2) % CLOCK_WRAP - CLOCK_WRAP // 2
