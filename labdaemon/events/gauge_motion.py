"""What a gauge saw during one capture: the same members in events, `capture.toml`, the journal and `gauges.csv`."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, ConfigDict


class GaugeMotion(BaseModel):
    """Motion of the point that a gauge looks at, over the exposure of a capture, as displacement.

    Every number is None where it is not known; `reason` says why there are none at all. Amplitudes are zero to peak. An
    accelerometer's are converted to displacement, each harmonic at its own frequency; it has no offset and no drift.

    Attributes
    ----------
    gauge, role, unit
        Name of the gauge, what it is mounted on (``table``, ``response``), and the unit it measures in.
    frequency_hz, sd_frequency_hz
        Of the fundamental, by the gauge's own clock.
    amplitude_mm, sd_amplitude_mm
        Of the fundamental.
    phase_rad, sd_phase_rad
        Of the fundamental against the excitation's phase reference: with ωt measured from that, it moves as
        ``amplitude_mm sin(ωt + phase_rad)``. The standard deviation includes what the wire may delay.
    h2_mm, sd_h2_mm, h2_phase_rad, sd_h2_phase_rad
        Second harmonic: amplitude, and phase against the fundamental's own θ, as ``h2_mm sin(2θ + h2_phase_rad)``.
        Likewise up to the fifth.
    offset_mm, sd_offset_mm
        Mean reading in the middle of the record.
    drift_mm_s, sd_drift_mm_s
        Its change.
    noise_mm
        Standard deviation of one reading about the fitted motion.
    readings, duration_s, cycles
        Readings used, and length of the record in seconds and in cycles of the fundamental. Where the exposure holds
        too few cycles, the record begins before it.
    reason
        Why there is no result.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="ignore")

    gauge: str
    role: str | None = None
    unit: str | None = None
    frequency_hz: float | None = None
    sd_frequency_hz: float | None = None
    amplitude_mm: float | None = None
    sd_amplitude_mm: float | None = None
    phase_rad: float | None = None
    sd_phase_rad: float | None = None
    h2_mm: float | None = None
    sd_h2_mm: float | None = None
    h2_phase_rad: float | None = None
    sd_h2_phase_rad: float | None = None
    h3_mm: float | None = None
    sd_h3_mm: float | None = None
    h3_phase_rad: float | None = None
    sd_h3_phase_rad: float | None = None
    h4_mm: float | None = None
    sd_h4_mm: float | None = None
    h4_phase_rad: float | None = None
    sd_h4_phase_rad: float | None = None
    h5_mm: float | None = None
    sd_h5_mm: float | None = None
    h5_phase_rad: float | None = None
    sd_h5_phase_rad: float | None = None
    offset_mm: float | None = None
    sd_offset_mm: float | None = None
    drift_mm_s: float | None = None
    sd_drift_mm_s: float | None = None
    noise_mm: float | None = None
    readings: int | None = None
    duration_s: float | None = None
    cycles: float | None = None
    reason: str | None = None
