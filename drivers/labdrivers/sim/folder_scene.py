"""What a rendered data-set folder shows: everything that `make_folder` can vary, with its units."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

WHITE_DN = 2900.0


@dataclass(frozen=True, slots=True)
class FolderScene:
    """A data-set folder to be rendered.

    Attributes
    ----------
    seed
        Of everything random in it.
    cameras
        1 (planar motion), 2 or 3 (motion in space).
    size
        ``small`` (1936 x 1296, 12.2 µm pixels) or ``d80`` (3900 x 2613, 6.1 µm).
    targets, diameters_mm
        How many dots, and their diameters in turn.
    amplitude_mm
        Smallest and largest semi-amplitude; drawn evenly in their logarithm.
    orbit
        Ratio of minor to major semi-axis, 0 for straight paths.
    in_phase
        All targets of a capture move in or against one phase, as a structure does in one of its modes.
    level
        All targets move in the horizontal plane, which is the epipolar plane of two cameras at one height.
    captures
        How many, each with motions of its own.
    frequency_hz, exposure_s
        Excitation and shutter; a product that is no whole number leaves a part cycle.
    phase_rad
        Opening phases. Every capture then becomes a group of exposures of the same motion, one at each phase.
    light
        Codes of the lamp, as brightnesses of equal sectors of one cycle. Every capture then becomes a group of
        exposures of the same motion, one under each code.
    light_phase_rad, ambient, lamp_rise_s
        Excitation phase at which the codes begin, the room's light in parts of the lamp's, and the lamp's rise time.
    tell
        What `capture.toml` says: ``all`` (frequency, exposure, phase and group), ``window`` (no phase) or ``nothing``.
    rest_offset_mm
        Standard deviation by which the mean position differs from rest.
    sharp_frames
        Frames at rest, each with its own noise.
    camera_shift_px, defocus_px
        How far each blurred frame is shifted on the sensor against the sharp one (in a random direction), and how
        much it is out of focus (diameter of the blur circle).
    white_dn, sharp_white_dn
        What white paper reads in the middle of blurred and of sharp frames; above 4095 it is clipped.
    occluded
        How many targets of each blurred frame have a cable hanging before them.
    paper_mm
        Side of the labels; by default so large that their blurred edges stay clear of the blurred dots.
    texture, texture_length_mm, still_paper, gradient
        Relative sd of the paper texture; labels that do not move with their dots; slope of the light (see `Scene`).
    read_noise_e
        Of the sensor, electrons.
    gaussian_optics, nef, pattern
        Gaussian lens blur in place of diffraction; the D80's compression; colour mosaic.
    survey_sd_mm
        Error of the surveyed control points, as stated in their file.
    distance_mm
        From cameras to targets.
    approximate_places
        Write `targets.csv` as well.

    Raises
    ------
    ValueError
        An option is not offered.
    """

    seed: int = 0
    cameras: int = 2
    size: str = "small"
    targets: int = 24
    diameters_mm: tuple[float, ...] = (8.0,)
    amplitude_mm: tuple[float, float] = (0.3, 3.0)
    orbit: float = 0.0
    in_phase: bool = False
    level: bool = False
    captures: int = 1
    frequency_hz: float = 5.0
    exposure_s: float = 1.0
    phase_rad: tuple[float, ...] | None = None
    light: tuple[tuple[float, ...], ...] | None = None
    light_phase_rad: float = 0.0
    ambient: float = 0.0
    lamp_rise_s: float = 0.0
    tell: str = "all"
    rest_offset_mm: float = 0.0
    sharp_frames: int = 1
    camera_shift_px: float = 0.0
    defocus_px: float = 0.0
    white_dn: float = WHITE_DN
    sharp_white_dn: float = WHITE_DN
    occluded: int = 0
    paper_mm: float | None = None
    texture: float = 0.004
    texture_length_mm: float = 0.3
    still_paper: bool = False
    gradient: tuple[float, float] = (0.08, -0.05)
    read_noise_e: float = 7.0
    gaussian_optics: bool = False
    nef: bool = True
    pattern: str = "RGGB"
    survey_sd_mm: float = 0.05
    distance_mm: float = 1000.0
    approximate_places: bool = False

    def __post_init__(self) -> None:
        if self.tell not in ("all", "window", "nothing"):
            raise ValueError(f"tell must be 'all', 'window' or 'nothing', not {self.tell!r}")

    @classmethod
    def of(cls, **values: Any) -> FolderScene:
        """Build it from plain values, lists included.

        Raises
        ------
        TypeError
            There is no such option; the message names it.
        """
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise TypeError(f"a folder has no option {unknown[0]!r}; it has {', '.join(sorted(known))}")
        return cls(**{name: _frozen(value) for name, value in values.items()})

    @property
    def label_side_mm(self) -> float:
        """Side of the labels: as given, else so large that their blurred edges stay clear of the blurred dots."""
        if self.paper_mm is not None:
            return self.paper_mm
        edges = 2.0 if self.still_paper else 4.0
        drift = 6.0 * self.rest_offset_mm if self.still_paper else 0.0
        return max(float(size) for size in self.diameters_mm) + edges * self.amplitude_mm[1] + 10.0 + drift


def _frozen(value: Any) -> Any:
    """Lists and arrays as tuples."""
    if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
        return value
    return tuple(_frozen(one) for one in value)
