"""From a sharp and a blurred patch of a target to its motion in pixels, with covariance, at the photon limit.

Arrays in, arrays out; `measure`, `measure_frame` and `measure_group` are the ways in. The rooms behind them, lowest
first: ``patch`` (what the sensor saw), ``solver``, ``spectra`` (dot, lens, pixel, motion in closed form), ``sharp``
(the target at rest), ``smear`` (the modelled picture), ``fit`` (whole cycles, declared laws) and ``phase`` (windows of
part cycles). ``published`` holds the published method, to compare with.
"""

from labdaemon.blur.fit.still import measure_still
from labdaemon.blur.frame import displacement, measure_frame
from labdaemon.blur.group import measure_group
from labdaemon.blur.law import DisplacementLaw
from labdaemon.blur.measure import measure
from labdaemon.blur.motion import ExtraBlur, Measurement, Start, StillMeasurement, Window
from labdaemon.blur.patch.noise import estimate_noise
from labdaemon.blur.patch.pixels import Dot, NoiseModel, Patch
from labdaemon.blur.phase.signs import RelativeSigns, relative_signs
from labdaemon.blur.sharp.fit_sharp import fit_sharp
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.texture import sharp_texture
from labdaemon.blur.smear.defocus import frame_blur

__all__ = [
    "DisplacementLaw",
    "Dot",
    "ExtraBlur",
    "Measurement",
    "NoiseModel",
    "Patch",
    "RelativeSigns",
    "SharpTarget",
    "Start",
    "StillMeasurement",
    "Window",
    "displacement",
    "estimate_noise",
    "fit_sharp",
    "frame_blur",
    "measure",
    "measure_frame",
    "measure_group",
    "measure_still",
    "relative_signs",
    "sharp_texture",
]
