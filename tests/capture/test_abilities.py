from __future__ import annotations

from labdaemon.capture import abilities
from labdrivers.rts_trigger import RtsTrigger
from labdrivers.scpi import ScpiShaker
from labdrivers.trigger_box import TriggerBox


class Plain:
    name = "plain"


class Silent:
    """A lab's own driver, which says all it can of itself."""

    holds_enable = False
    can_switch_off = False
    reports_amplifier = True
    reopens = True


def test_a_driver_that_says_nothing_has_the_careful_defaults():
    plain = Plain()
    assert abilities.holds_enable_line(plain)
    assert abilities.can_switch_off(plain)
    assert not abilities.reports_amplifier(plain)
    assert not abilities.reopens_wire(plain)


def test_a_driver_is_believed():
    said = Silent()
    assert not abilities.holds_enable_line(said)
    assert not abilities.can_switch_off(said)
    assert abilities.reports_amplifier(said)
    assert abilities.reopens_wire(said)


def test_our_drivers_have_their_abilities():
    assert issubclass(ScpiShaker, abilities.AmplitudeTrimmer)
    assert issubclass(ScpiShaker, abilities.ExcitationChecker)
    assert isinstance(ScpiShaker, abilities.SettingsSource)
    assert abilities.holds_enable_line(TriggerBox)
    assert not abilities.holds_enable_line(RtsTrigger)
    assert abilities.reopens_wire(ScpiShaker)
    assert abilities.reopens_wire(TriggerBox)
