"""Many envelopes to findings: resonances, mode shapes, and what changed between two states of a structure.

Pure: arrays in, arrays out. `response` is the input, `find_modes` and `spectra` find the modes, `next_frequency` says
where to measure next.
"""

from labdaemon.findings.amplitude_dependence import AmplitudeDependence, compare_levels
from labdaemon.findings.find_modes import Mode, ModeSearch, find_modes
from labdaemon.findings.linearise import ModalParameters, ModalProblem
from labdaemon.findings.modal_basis import ModalBasis, ModeForm
from labdaemon.findings.modal_fit import ModalFit, fit, initial_parameters, refit
from labdaemon.findings.next_frequency import (
    NextStep,
    candidate_frequencies,
    is_settled,
    joined,
    next_frequency,
    remaining_transient,
)
from labdaemon.findings.phase_retrieval import with_residues
from labdaemon.findings.response import PhaseReference, ResponseSeries, frequency_response
from labdaemon.findings.spectra import SpectralModes, find_spectral_modes
from labdaemon.findings.transient import with_transients
from labdaemon.findings.transmissibility import Transmissibility, amplitude_ratio, transmissibility_of

__all__ = [
    "AmplitudeDependence",
    "ModalBasis",
    "ModalFit",
    "ModalParameters",
    "ModalProblem",
    "Mode",
    "ModeForm",
    "ModeSearch",
    "NextStep",
    "PhaseReference",
    "ResponseSeries",
    "SpectralModes",
    "Transmissibility",
    "amplitude_ratio",
    "candidate_frequencies",
    "compare_levels",
    "find_modes",
    "find_spectral_modes",
    "fit",
    "frequency_response",
    "initial_parameters",
    "is_settled",
    "joined",
    "next_frequency",
    "refit",
    "remaining_transient",
    "transmissibility_of",
    "with_residues",
    "with_transients",
]
