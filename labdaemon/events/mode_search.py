"""What a search for modes has decided: the same members in events and in the journal."""

from __future__ import annotations

from labdaemon.events.payloads import EventPart


class ModeEstimate(EventPart):
    """A natural frequency and damping ratio as they are known now.

    Attributes
    ----------
    frequency_hz, sd_frequency_hz
        Undamped natural frequency, hertz.
    damping, sd_damping
        Damping ratio, a fraction of critical.
    """

    frequency_hz: float
    sd_frequency_hz: float
    damping: float
    sd_damping: float


class DecisionData(EventPart):
    """``data`` of ``step.decided``: the excitation of a step that the plan left open, or the end of a search.

    Attributes
    ----------
    step
        Index of the step, from 0.
    search
        Number of the search for modes, from 0 in each campaign.
    frequency_hz, amplitude_mm
        Excitation: hertz, and millimetres of the table, zero to peak; None where the search has ended.
    hold_s
        Time to wait after the table has settled, seconds.
    reason
        Why, in a few words.
    measured
        Number of steps with results that this was decided from.
    pending
        Steps that were captured and not measured yet; they counted as what the model expects of them.
    modes
        The modes as they are known now, in ascending frequency.
    residual_terms
        Number of residual terms of the model; None where there is no model.
    is_reached
        Whether the search ended with what was wanted; None while it continues.
    """

    step: int
    search: int
    frequency_hz: float | None = None
    amplitude_mm: float | None = None
    hold_s: float = 0.0
    reason: str = ""
    measured: int = 0
    pending: tuple[int, ...] = ()
    modes: tuple[ModeEstimate, ...] = ()
    residual_terms: int | None = None
    is_reached: bool | None = None
