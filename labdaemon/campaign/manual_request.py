"""What a person, or the software of an outside system, says of a capture that belongs to no campaign."""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass

LONGEST_NAME_BYTES = 90
"""Of the label's part in a file name: overlays add number, camera and suffix, and a file name has 255 bytes at most."""
MAX_TEXT = 200
"""Characters of a label, a group or a request's id."""
FREQUENCY_HZ = (1e-3, 1e4)
AMPLITUDE_MM = (0.0, 1e4)
PHASE_RAD = (-1e4, 1e4)
EXPOSURE_S = (1e-5, 3600.0)
"""Smallest and largest value that may be stated."""
RESERVED = frozenset('/\\<>:"|?*#%`$&;')
"""Printable characters that some file system, shell or link reads as something else."""


@dataclass(frozen=True, slots=True)
class ManualRequest:
    """A capture outside any campaign, as it was asked for.

    Attributes
    ----------
    label
        What a person calls it; any text, or empty.
    is_sharp
        A sharp set at rest for captures to come, rather than a blurred capture.
    request_id
        Sent again it is answered the same, and nothing is fired twice.
    frequency_hz, amplitude_mm
        Of the excitation, where it is known; otherwise the table gauge is asked.
    phase_rad
        Excitation phase at the opening, where it is known.
    group
        Captures of one group are measured jointly and reported once, under this name.
    exposure_s
        Set on the bodies where the daemon releases; a statement of what they are set to where others do. None for the
        rig file's, or what the frame itself says.
    """

    label: str = ""
    is_sharp: bool = False
    request_id: str | None = None
    frequency_hz: float | None = None
    amplitude_mm: float | None = None
    phase_rad: float | None = None
    group: str | None = None
    exposure_s: float | None = None


def safe_name(label: str) -> str:
    """The label as a part of a file name on any system: letters of all scripts stay, what is unsafe becomes ``-``.

    >>> safe_name("Riß 7 / left")
    'Riß 7 - left'
    """
    text = unicodedata.normalize("NFC", label)
    kept = "".join("-" if letter in RESERVED or not letter.isprintable() else letter for letter in text)
    words = " ".join(kept.split())
    while len(words.encode("utf-8", "replace")) > LONGEST_NAME_BYTES:
        words = words[:-1]
    return words.strip(" .")


def capture_name(number: int, label: str) -> str:
    """Name of a manual capture: the number makes it unique and sorts it, the label makes it findable.

    >>> capture_name(7, "crack-7")
    'manual-000007-crack-7'
    """
    name = safe_name(label)
    return f"manual-{number:06d}" + (f"-{name}" if name else "")


def is_group_name(name: str) -> bool:
    """Whether a name can be a group's: it is reported, and names files, as it stands."""
    return bool(name) and safe_name(name) == unicodedata.normalize("NFC", name) and not name.startswith(".")
