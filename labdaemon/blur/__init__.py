"""From a sharp and a blurred patch of a target to its motion in pixels, with covariance, at the photon limit.

Arrays in, arrays out; `measure`, `measure_frame` and `measure_group` are the ways in. The rooms behind them, lowest
first: ``patch`` (what the sensor saw), ``solver``, ``spectra`` (dot, lens, pixel, motion in closed form), ``sharp``
(the target at rest), ``smear`` (the modelled image), ``fit`` (whole cycles, declared laws) and ``phase`` (windows of
part cycles). ``mccarthy2016`` holds the published method, to compare with. `predict_sd` and `nearest_twin` say before a
capture how well it will know a motion.
"""

from labdaemon.blur.average import average_measurements
from labdaemon.blur.fit.refit import failure_flags
from labdaemon.blur.fit.static_target import measure_static
from labdaemon.blur.fit.texture import measure_moment
from labdaemon.blur.frame import measure_displacement, measure_frame
from labdaemon.blur.group import TargetFrames, estimate_group_harmonic, measure_group
from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.light_code import LightCode, mirror_axes, named_code
from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.mccarthy2016.method import measure_mccarthy2016
from labdaemon.blur.measure import measure
from labdaemon.blur.motion import (
    AlternativeMotion,
    Defocus,
    ExposureWindow,
    InitialGuess,
    Measurement,
    StaticMeasurement,
    with_relative_sd,
)
from labdaemon.blur.patch.ellipse import Ellipse, ellipse_from_moments, fit_ellipse
from labdaemon.blur.patch.noise import estimate_noise
from labdaemon.blur.patch.pixels import Dot, FloatArray, NoiseModel, Patch
from labdaemon.blur.phase.light_check import LightFault, find_light_fault
from labdaemon.blur.phase.shared_waveform import SharedWaveform, estimate_waveform
from labdaemon.blur.phase.signs import RelativeSigns, decide_sign, find_relative_signs
from labdaemon.blur.phase.third_harmonic import ThirdHarmonic
from labdaemon.blur.prediction import (
    DotImage,
    PredictedSd,
    light_fraction,
    motion_information,
    motion_vectors,
    predict_sd,
    sd_of_information,
)
from labdaemon.blur.settings import MEASURE, TEXTURE_MAP
from labdaemon.blur.shared_ambient import CommonAmbient, estimate_common_ambient, free_ambient, share_ambient
from labdaemon.blur.shared_rest import share_rest
from labdaemon.blur.sharp.fit_sharp import fit_sharp, unmeasurable_target
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import MIN_SIDE_PX, make_textured_patch
from labdaemon.blur.smear.defocus import estimate_frame_defocus
from labdaemon.blur.threshold import PhaseScatter, predict_scatter
from labdaemon.blur.twins import Twin, nearest_twin
from labdaemon.blur.unsolvable import solved
from labdaemon.blur.waveform import MotionWaveform

__all__ = [
    "LIGHT",
    "MEASURE",
    "MIN_SIDE_PX",
    "TEXTURE_MAP",
    "AlternativeMotion",
    "CommonAmbient",
    "Defocus",
    "Dot",
    "DotImage",
    "Ellipse",
    "ExposureWindow",
    "FloatArray",
    "InitialGuess",
    "LightCode",
    "LightFault",
    "Measurement",
    "MotionHarmonics",
    "MotionWaveform",
    "NoiseModel",
    "Patch",
    "PhaseScatter",
    "PredictedSd",
    "RelativeSigns",
    "SharedWaveform",
    "SharpTarget",
    "StaticMeasurement",
    "TargetFrames",
    "ThirdHarmonic",
    "Twin",
    "average_measurements",
    "decide_sign",
    "ellipse_from_moments",
    "estimate_common_ambient",
    "estimate_frame_defocus",
    "estimate_group_harmonic",
    "estimate_noise",
    "estimate_waveform",
    "failure_flags",
    "find_light_fault",
    "find_relative_signs",
    "fit_ellipse",
    "fit_sharp",
    "free_ambient",
    "light_fraction",
    "make_textured_patch",
    "measure",
    "measure_displacement",
    "measure_frame",
    "measure_group",
    "measure_mccarthy2016",
    "measure_moment",
    "measure_static",
    "mirror_axes",
    "motion_information",
    "motion_vectors",
    "named_code",
    "nearest_twin",
    "predict_scatter",
    "predict_sd",
    "sd_of_information",
    "share_ambient",
    "share_rest",
    "solved",
    "unmeasurable_target",
    "with_relative_sd",
]
