"""The excitations that a phase of a campaign asks for."""

from __future__ import annotations

from collections.abc import Iterator

from labdaemon.campaign.campaign_file import DwellPhase, ResonancePhase, StepsPhase, SweepPhase, frequencies

ExcitedPhase = StepsPhase | SweepPhase | ResonancePhase | DwellPhase
SETTLED_SD = 0.002
"""Relative sd of an amplitude of a first sweep, a third of which may be left of a transient."""
FREQUENCY_DIGITS = 3
"""Decimals of a frequency that is chosen for a table: generators round to a millihertz."""


def hold_after_settling_s(phase: ExcitedPhase, frequency_hz: float) -> float:
    """Time to hold an excitation once it counts as settled."""
    match phase:
        case DwellPhase():
            return phase.hold_s
        case ResonancePhase():
            # Loaded where it is asked for: numerics take longer to load than a plan to make.
            from labdaemon.findings.transient import settling_hold_s

            rule = phase.settle
            return settling_hold_s(rule.max_change_per_cycle, rule.damping_ratio, frequency_hz, SETTLED_SD)
        case _:
            return 0.0


def excitations(phase: ExcitedPhase) -> Iterator[tuple[float, float, str, str]]:
    """Frequency, amplitude and the keys that they were read from, in the order of the file."""
    if isinstance(phase, ResonancePhase):
        from labdaemon.findings.closed_loop import first_sweep

        for frequency_hz in first_sweep(phase.band_hz):
            yield round(float(frequency_hz), FREQUENCY_DIGITS), phase.amplitude_mm, "band_hz", "amplitude_mm"
        return
    if isinstance(phase, DwellPhase):
        assert phase.frequency_hz is not None
        yield phase.frequency_hz, phase.amplitude_mm, "frequency_hz", "amplitude_mm"
        return
    values = frequencies(phase.frequency_hz)
    is_list = isinstance(phase.frequency_hz, tuple)
    for place, frequency_hz in enumerate(values):
        frequency_key = f"frequency_hz[{place}]" if is_list else "frequency_hz"
        if isinstance(phase, SweepPhase):
            yield frequency_hz, phase.amplitude_at(frequency_hz), frequency_key, phase.level_key
        elif isinstance(phase.amplitude_mm, tuple):
            yield frequency_hz, phase.amplitude_mm[place], frequency_key, f"amplitude_mm[{place}]"
        else:
            yield frequency_hz, phase.amplitude_mm, frequency_key, "amplitude_mm"
