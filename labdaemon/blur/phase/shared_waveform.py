"""What the targets of a frame say together of the waveform: part cycles, a third harmonic, or uneven light.

Both change the ends of a path, where a target dwells. The one that explains the images better is taken; whole cycles of
a sinusoid stay where neither is needed. Where the exposure is known to be of whole cycles, and the targets spend more
time on one half of their paths, the light was not constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from labdaemon.blur.motion import Defocus, ExposureWindow, Measurement
from labdaemon.blur.patch.pixels import Patch
from labdaemon.blur.phase.third_harmonic import ThirdHarmonic, third_harmonic
from labdaemon.blur.phase.uneven_light import is_light_uneven
from labdaemon.blur.phase.unknown_window import UnknownWindow, estimate_window, window_gain
from labdaemon.blur.phase.window_evidence import collect_evidence
from labdaemon.blur.sharp.target import SharpTarget


@dataclass(frozen=True, slots=True)
class SharedWaveform:
    """What the targets say.

    Attributes
    ----------
    exposure
        The exposure, where it was not known.
    harmonic
        The third harmonic; None where there is none to be seen.
    is_light_uneven
        Whether the light changed over the excitation's cycle, or the exposure was far from whole cycles, although
        constant light over whole cycles was stated.
    """

    exposure: UnknownWindow | None = None
    harmonic: ThirdHarmonic | None = None
    is_light_uneven: bool = False

    @property
    def window(self) -> ExposureWindow | None:
        """The exposure that the targets show, of unknown phase; None where whole cycles are not excluded."""
        return None if self.exposure is None else self.exposure.window

    @property
    def relative_sd(self) -> float:
        """Standard deviation of every amplitude, over the amplitude, because of what stays open."""
        if self.harmonic is not None:
            return self.harmonic.relative_sd
        return 0.0 if self.exposure is None else self.exposure.relative_sd


def estimate_waveform(
    sharps: Sequence[SharpTarget],
    patches: Sequence[Patch],
    measured: Sequence[Measurement],
    *,
    defocus: Defocus | None = None,
    expected: tuple[float, float] | None = None,
    whole: bool = False,
) -> SharedWaveform:
    """Estimate what a frame's targets share.

    Parameters
    ----------
    sharps, patches, measured
        Each target, its part of the frame, and its motion as over whole cycles.
    defocus
        Of the frame.
    expected
        Cycles and their standard deviation, where frequency and exposure are roughly known.
    whole
        Whether the exposure is known to be of whole cycles, so that only a harmonic is left.
    """
    evidence = collect_evidence(sharps, patches, measured, defocus)
    if whole and is_light_uneven(evidence):
        return SharedWaveform(is_light_uneven=True)
    harmonic = third_harmonic(evidence)
    if whole or (harmonic is not None and harmonic.gain > window_gain(evidence)):
        return SharedWaveform(harmonic=harmonic)
    return SharedWaveform(estimate_window(evidence, expected))
