"""What to do about each flag, in one line; `docs/how-to/read-the-flags.md` says it at length."""

from __future__ import annotations

from labdaemon.flags import Flag

REMEDIES = {
    Flag.NOT_FOUND: "Check that the target is in view of every camera, lit, and present in the sharp frame.",
    Flag.AT_REST: "The motion is below the detection limit: larger dots, more light or more sharp frames lower it.",
    Flag.SATURATED: "Use a shorter exposure, a smaller aperture, a lower ISO or less light.",
    Flag.OCCLUDED: "Something covers a part of the target: move the cable, or the camera.",
    Flag.PAPER_EDGE: "The blur reaches the end of the white label: use larger labels or a smaller amplitude.",
    Flag.POOR_FIT: "The motion is not what the model says: check the frequency, and harmonics of the shaker.",
    Flag.AMBIGUOUS: "The cameras do not decide between two solutions: add a camera, or capture at two phases.",
    Flag.PART_CYCLES: "The exposure is no whole number of cycles: state its phase, or change the exposure.",
    Flag.UNDETERMINED: "The texture shows no motion along one direction: choose another patch, or put a dot there.",
    Flag.MIXED_MOTION: "Parts of the patch move differently: make the patch smaller.",
    Flag.CAMERA_MOVED: "The control targets moved in this frame: check the tripod, and repeat the capture.",
    Flag.CONTRADICTS_GROUP: "The captures of the group differ: check that the excitation stayed the same.",
    Flag.LIGHT_MISMATCH: "The light was not the code that was stated: check the lamp and its wiring.",
}
"""Flag -> what to do."""


def remedy(flag: str) -> str:
    """What to do about a flag; empty for one that this version does not know."""
    return next((text for known, text in REMEDIES.items() if known.value == flag), "")
