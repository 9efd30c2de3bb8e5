"""From a sharp and a blurred patch of a target to its motion in pixels, with covariance, at the photon limit."""

from labdaemon.blur.defocus import frame_blur
from labdaemon.blur.fit_sharp import fit_sharp
from labdaemon.blur.frame import displacement, measure_frame
from labdaemon.blur.group import measure_group
from labdaemon.blur.law import DisplacementLaw
from labdaemon.blur.measure import measure
from labdaemon.blur.motion import ExtraBlur, Measurement, Start, StillMeasurement, Window
from labdaemon.blur.noise import estimate_noise
from labdaemon.blur.pixels import Dot, NoiseModel, Patch
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.signs import RelativeSigns, relative_signs
from labdaemon.blur.still import measure_still
from labdaemon.blur.texture import sharp_texture

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
