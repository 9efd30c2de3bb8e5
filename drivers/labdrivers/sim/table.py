"""The shaker table: amplifier, limits, and a history of commands from which its motion at any past time is known.

The controller's voltage becomes displacement through H(f) = gain/(1 + i f/corner), so millimetres per volt fall and
lag with frequency, as an electrodynamic shaker's do. A new command fades the old sinusoid out and the new one in with
the amplifier's time constant: between two commands the table's displacement is a sum of complex exponentials.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from labdrivers.sim.structure import FloatArray, FreeVibration, VibrationMode, modal_response

NEGLIGIBLE_MM = 1e-9


@dataclass(frozen=True, slots=True)
class TableSpec:
    """What the table can do. Amplitudes are zero to peak.

    Attributes
    ----------
    gain_mm_per_v, corner_hz
        Displacement per volt at 0 Hz, and where it has fallen to 71 %.
    fade_s
        Time constant with which the amplifier follows a change of command.
    stroke_mm
        Whole travel, peak to peak.
    velocity_mm_s, acceleration_mm_s2
        Largest values of a sine; beyond any limit the amplifier trips and the table comes to rest.
    frequency_hz
        Usable range.
    harmonics
        Order, amplitude over the fundamental's, and phase δ (rad) of each harmonic of the table's motion: with θ the
        fundamental's phase it adds ``ratio · sin(order · θ + δ)``. The structure answers each at its own frequency.
    """

    gain_mm_per_v: float = 4.2
    corner_hz: float = 9.0
    fade_s: float = 0.08
    stroke_mm: float = 150.0
    velocity_mm_s: float = 1000.0
    acceleration_mm_s2: float = 20000.0
    frequency_hz: tuple[float, float] = (0.5, 50.0)
    harmonics: tuple[tuple[int, float, float], ...] = ()

    def response(self, frequency_hz: float) -> complex:
        """Complex displacement per volt at a frequency, mm/V."""
        return self.gain_mm_per_v / complex(1.0, frequency_hz / self.corner_hz)

    def calibration(self) -> list[tuple[float, float]]:
        """(frequency_hz, mm_per_v) as a laboratory would have measured it for the controller: every half octave."""
        frequencies = [2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 14.0, 16.0, 20.0, 25.0, 30.0]
        return [(f, round(abs(self.response(f)), 4)) for f in frequencies]

    def refuses(self, frequency_hz: float, amplitude_mm: float) -> str | None:
        """Why the amplifier trips on this sine, or None."""
        omega = 2.0 * np.pi * frequency_hz
        if 2.0 * amplitude_mm > self.stroke_mm:
            return f"stroke {2 * amplitude_mm:.1f} mm beyond {self.stroke_mm:g} mm"
        if omega * amplitude_mm > self.velocity_mm_s:
            return f"velocity {omega * amplitude_mm:.0f} mm/s beyond {self.velocity_mm_s:g} mm/s"
        if omega**2 * amplitude_mm > self.acceleration_mm_s2:
            return f"acceleration {omega**2 * amplitude_mm:.0f} mm/s² beyond {self.acceleration_mm_s2:g} mm/s²"
        return None


@dataclass(frozen=True, slots=True)
class ExcitationInterval:
    """From one command to the next.

    Attributes
    ----------
    start_s
        When the command came.
    frequency_hz
        Of the generator; its phase is ``phase_rad + 2π·frequency_hz·(t - start_s)``.
    amplitude_mm
        Of the table once settled.
    state
        The table's exponentials and the modes' state at `start_s`.
    """

    start_s: float
    frequency_hz: float
    phase_rad: float
    amplitude_mm: float
    state: FreeVibration

    def phase(self, t: FloatArray | float) -> FloatArray:
        """The generator's phase ωt (its sync output rises at multiples of 2π)."""
        return np.asarray(self.phase_rad + 2.0 * np.pi * self.frequency_hz * (np.asarray(t, float) - self.start_s))


@dataclass(frozen=True, slots=True)
class ExcitationHistory:
    """All commands so far; immutable, so a snapshot is a reference and a renderer's process can have it."""

    modes: tuple[VibrationMode, ...]
    intervals: tuple[ExcitationInterval, ...] = field(default=())

    def _split(self, t: FloatArray) -> list[tuple[ExcitationInterval, slice]]:
        """Cut ascending times at the commands. Times before the first belong to it, with nothing moving yet."""
        during = self.window(float(t[0]), float(t[-1])).intervals
        cuts = np.searchsorted(t, [interval.start_s for interval in during[1:]], side="left")
        edges = [0, *cuts.tolist(), t.size]
        pairs = zip(during, edges[:-1], edges[1:], strict=True)
        return [(interval, slice(lo, hi)) for interval, lo, hi in pairs if hi > lo]

    def evaluate(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Table displacement (n,) and modal coordinates (modes, n) at ascending times, mm."""
        times = np.asarray(t, float)
        table, q = np.zeros(times.size), np.zeros((len(self.modes), times.size))
        if self.intervals and times.size:
            for interval, part in self._split(times):
                elapsed = np.maximum(times[part] - interval.start_s, 0.0)
                state = interval.state
                for pole, amplitude in zip(state.poles, state.amplitudes, strict=True):
                    table[part] += (amplitude * np.exp(pole * elapsed)).real
                q[:, part] = modal_response(self.modes, state, elapsed)[0]
        return table, q

    def at(self, t: float) -> ExcitationInterval | None:
        """The command in force at `t`."""
        index = self._last(t)
        return self.intervals[index] if index >= 0 else None

    def window(self, start_s: float, end_s: float) -> ExcitationHistory:
        """Only what matters between two times (small enough to send to another process)."""
        return ExcitationHistory(
            self.modes, self.intervals[max(self._last(start_s), 0) : max(self._last(end_s), 0) + 1]
        )

    def _last(self, t: float) -> int:
        """Index of the last command not after `t`, -1 before the first."""
        return bisect_right(self.intervals, t, key=lambda interval: interval.start_s) - 1

    def then(
        self, t: float, spec: TableSpec, *, frequency_hz: float, level_v: float, phase_rad: float
    ) -> ExcitationHistory:
        """History with one more command: a sine of `level_v` volts (zero to peak) whose phase at `t` is `phase_rad`."""
        last = self.intervals[-1] if self.intervals else None
        if last is not None and t < last.start_s:
            raise ValueError(f"command at {t:.6f} s lies before the last one at {last.start_s:.6f} s")
        new_pole = complex(0.0, 2.0 * np.pi * frequency_hz)
        response = spec.response(frequency_hz) * level_v
        # displacement |H| V sin(phase - lag) is the real part of -i H V exp(i phase)
        steady = -1j * response * np.exp(1j * phase_rad)
        fading: dict[complex, complex] = {}
        displacement, velocity = [0.0] * len(self.modes), [0.0] * len(self.modes)
        rate_before = 0.0
        if last is not None:
            elapsed = t - last.start_s
            for pole, amplitude in zip(last.state.poles, last.state.amplitudes, strict=True):
                now = amplitude * np.exp(pole * elapsed)
                rate_before += (now * pole).real
                faded = pole if pole.real < 0 else pole - 1.0 / spec.fade_s
                fading[faded] = fading.get(faded, 0j) + now
            q, dq = modal_response(self.modes, last.state, np.array([elapsed]))
            displacement, velocity = q[:, 0].tolist(), dq[:, 0].tolist()
        lasting = [(new_pole, steady)]
        for order, ratio, delta in spec.harmonics:
            angle = order * (phase_rad + np.angle(response)) + delta
            lasting.append((order * new_pole, -1j * ratio * abs(response) * np.exp(1j * angle)))
        for pole, value in lasting:
            faded = pole - 1.0 / spec.fade_s
            fading[faded] = fading.get(faded, 0j) - value
        terms = [(pole, value) for pole, value in fading.items() if abs(value) > NEGLIGIBLE_MM]
        terms += lasting
        # A step of the table's velocity is an impulse to every mode.
        step = sum((value * pole).real for pole, value in terms) - rate_before
        state = FreeVibration(
            tuple(pole for pole, _ in terms),
            tuple(complex(value) for _, value in terms),
            tuple(displacement),
            tuple(value - step for value in velocity),
        )
        interval = ExcitationInterval(t, frequency_hz, float(phase_rad), float(abs(response)), state)
        return ExcitationHistory(self.modes, (*self.intervals, interval))


def rest_before(modes: Sequence[VibrationMode]) -> ExcitationHistory:
    """A rig that has never received a command."""
    return ExcitationHistory(tuple(modes))
