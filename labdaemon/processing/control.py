"""Control targets in a camera's sharp frames: read, measured, and kept as small images for later frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from labdaemon.blur import Dot, FloatArray, Patch, SharpTarget, fit_sharp, make_textured_patch
from labdaemon.errors import ConfigError, DataError
from labdaemon.geometry import Lens, OrientedCamera
from labdaemon.imaging import BITS, Grey, RawFrame, Ring, Tag, by_name, centre_of, families, find_rings, find_tags
from labdaemon.processing.survey import SurveyedPoint
from labdaemon.processing.thumbnails import Thumbnail

TAG_FAMILY = "apriltag-36h11"
SD_CENTRE_PX = 0.03
"""Least standard deviation of a control target's centre: print, paper that is not flat, lens model."""
SD_UNFITTED_PX = 0.3
"""Standard deviation of a tag whose sides could not be fitted: it keeps its corners as detected."""
WIDEST_PX = 56
"""Widest part of a control target that is compared with later frames: enough edges, and quick."""
RIM_PX = 8  # room for the blur of a tag's edge


TAG_SHARE, RING_DOT_SHARE = 0.5, 0.25
"""Radius around a surveyed centre within which a dot is the control target, in parts of its size."""


@dataclass(frozen=True, slots=True, eq=False)
class ControlTargets:
    """Control targets as a camera's sharp frame shows them.

    Attributes
    ----------
    family
        Their kind, as `[control] family`.
    names
        m names.
    centres_px
        (m, 2).
    sd_px
        (m,) of each coordinate.
    side_px
        (m,) apparent size, to be compared with `[control] size_mm`.
    outlines
        Polygon around each, (k, 2) px, in which nothing else is a target.
    sharp
        What they look like, to be compared with later frames.
    thumbnails
        The same as small images, to be located in later frames.
    other_outlines
        Polygons around coded targets that were read but are not used: not surveyed, or cut by the frame's border.
    """

    family: str
    names: tuple[str, ...] = ()
    centres_px: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    sd_px: FloatArray = field(default_factory=lambda: np.empty(0))
    side_px: FloatArray = field(default_factory=lambda: np.empty(0))
    outlines: tuple[FloatArray, ...] = ()
    sharp: tuple[SharpTarget, ...] = ()
    thumbnails: tuple[Thumbnail, ...] = ()
    other_outlines: tuple[FloatArray, ...] = ()


def check_family(family: str, source: Path) -> None:
    """Raise `ConfigError` for a kind of control target that cannot be read."""
    if family not in families() and ring_bits(family) is None:
        raise ConfigError(
            f"no control targets are called {family!r}; there are {', '.join([*families(), *_RINGS])}",
            source=source,
            key="control.family",
        )


_RINGS = {f"ring-{bits}": bits for bits in BITS}


def ring_bits(family: str) -> int | None:
    """Segments of a ring-coded family, None for other kinds."""
    return _RINGS.get(family)


@dataclass(frozen=True, slots=True, eq=False)
class _DetectedControlTarget:
    """A control target of either kind."""

    name: str
    centre_px: FloatArray
    sd_px: float
    side_px: float
    outline: FloatArray
    dot: Dot | None = None


def find_control(
    frame: RawFrame,
    frames: Sequence[RawFrame],
    grey: Grey,
    family: str,
    *,
    lens: Lens | None = None,
    known: Sequence[str] | None = None,
) -> ControlTargets:
    """Find the control targets of a sharp set.

    Parameters
    ----------
    frame, frames, grey
        The mean of the sharp frames, each of them, and the mean as a grey image.
    family
        Their kind.
    lens
        Interior orientation, for the centres of tags that a lens distorts.
    known
        Names in the survey; others are passed over. None takes all.

    Raises
    ------
    DataError
        One name is in view twice.
    """
    everything = _rings(frame, frames, grey, family) if ring_bits(family) else _tags(frame, family, lens)
    seen = [one for one in everything if known is None or one.name in known]
    sharp, thumbnails, kept = [], [], []
    for one in seen:
        box = _box(one, frame.size)
        if box is None:
            continue
        cuts = [_cut_with_rim(each, box) for each in frames]
        target = fit_sharp(one.dot, cuts) if one.dot is not None else make_textured_patch(cuts, box, name=one.name)
        kept.append(one)
        sharp.append(target)
        thumbnails.append(Thumbnail.cut(grey, box))
    return ControlTargets(
        family,
        tuple(one.name for one in kept),
        np.array([one.centre_px for one in kept]).reshape(-1, 2),
        np.array([one.sd_px for one in kept]),
        np.array([one.side_px for one in kept]),
        tuple(one.outline for one in kept),
        tuple(sharp),
        tuple(thumbnails),
        tuple(one.outline for one in everything if one not in kept),
    )


def surveyed_outlines(
    view: OrientedCamera, points: Sequence[SurveyedPoint], size_mm: float, family: str
) -> list[FloatArray]:
    """Polygons around the surveyed control targets as a camera sees them, read or not: nothing there is a target.

    Parameters
    ----------
    view
        The camera.
    points, size_mm, family
        The survey, the size of the control targets, and their kind.
    """
    places = np.array([(point.x_mm, point.y_mm, point.z_mm) for point in points]).reshape(-1, 3)
    centres, depth = view.project(places), view.to_camera_axes(places)[:, 2]
    # The dot of a ring has the surveyed centre itself; a tag is a square about it.
    share = RING_DOT_SHARE if ring_bits(family) else TAG_SHARE
    circle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    unit = np.stack((np.cos(circle), np.sin(circle)), axis=1)
    focal = float(np.mean(view.lens.focal_px))
    return [
        centre + share * size_mm * focal / z * unit
        for centre, z in zip(centres, depth, strict=True)
        if np.isfinite(centre).all() and z > 0
    ]


def read_control_places(frame: RawFrame, family: str) -> dict[str, FloatArray]:
    """Where control targets are in a later frame that shifted far; those seen twice are left out."""
    bits = ring_bits(family)
    seen: Sequence[Tag | Ring] = find_tags(frame, family) if bits is None else find_rings(frame, bits=bits)
    places: dict[str, FloatArray] = {}
    twice: set[str] = set()
    for one in seen:
        twice |= {one.name} & set(places)
        places[one.name] = one.centre_px if isinstance(one, Tag) else np.array([one.dot.x_px, one.dot.y_px])
    return {name: place for name, place in places.items() if name not in twice}


def _tags(frame: RawFrame, family: str, lens: Lens | None) -> list[_DetectedControlTarget]:
    seen = []
    for tag in by_name(find_tags(frame, family), where=str(frame.path)).values():
        middle = tag.corners_px.mean(axis=0)
        sides = np.hypot(*(tag.corners_px - np.roll(tag.corners_px, 1, axis=0)).T)
        seen.append(
            _DetectedControlTarget(
                tag.name,
                tag.centre_px if lens is None else _centre(tag, lens),
                float(np.hypot(tag.sd_px, SD_CENTRE_PX)) if tag.measured else SD_UNFITTED_PX,
                float(sides.max()),
                middle + 1.15 * (tag.corners_px - middle),
            )
        )
    return seen


def _rings(frame: RawFrame, frames: Sequence[RawFrame], grey: Grey, family: str) -> list[_DetectedControlTarget]:
    seen: dict[str, _DetectedControlTarget] = {}
    for ring in find_rings(grey, bits=ring_bits(family) or BITS[0]):
        if ring.name in seen:
            raise DataError(f"ring {ring.name} is in view twice; cover or remove one", file=frame.path)
        dot = replace(ring.dot, paper_px=1.9 * ring.dot.semi_minor_px, name=ring.name)
        half = int(np.ceil(1.9 * dot.semi_major_px))
        x, y = round(dot.x_px), round(dot.y_px)
        fitted = fit_sharp(dot, [each.patch(x - half, y - half, 2 * half + 1, 2 * half + 1) for each in frames])
        if not fitted.usable:
            continue
        sd = float(np.hypot(np.sqrt(np.trace(fitted.covariance_px2) / 2), SD_CENTRE_PX))
        seen[ring.name] = _DetectedControlTarget(
            ring.name, fitted.centre_px, sd, 2 * dot.semi_major_px, ring.outline_px, dot
        )
    return list(seen.values())


def _centre(tag: Tag, lens: Lens) -> FloatArray:
    """Centre of a tag whose sides the lens distorts."""
    centre: FloatArray = lens.distort(centre_of(lens.undistort(tag.corners_px))[None])[0]
    return centre if np.isfinite(centre).all() else tag.centre_px


def _box(one: _DetectedControlTarget, size: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """(x, y, width, height) of what is compared with later frames: the middle of a large target, all of a small one."""
    low, high = one.outline.min(axis=0), one.outline.max(axis=0)
    if one.dot is not None:
        reach = 1.6 * one.dot.semi_major_px
        low, high = one.centre_px - reach, one.centre_px + reach
    half = np.minimum((high - low) / 2, WIDEST_PX / 2)
    x0, y0 = (int(v) for v in np.maximum(np.floor(one.centre_px - half), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(one.centre_px + half), np.array(size) - 1))
    return (x0, y0, x1 - x0 + 1, y1 - y0 + 1) if min(x1 - x0, y1 - y0) >= 12 else None


def _cut_with_rim(frame: RawFrame, box: tuple[int, int, int, int]) -> Patch:
    """Cut the box with a rim around it, since what lies outside is blurred into the box."""
    width, height = frame.size
    x0, y0 = max(box[0] - RIM_PX, 0), max(box[1] - RIM_PX, 0)
    x1, y1 = min(box[0] + box[2] + RIM_PX, width), min(box[1] + box[3] + RIM_PX, height)
    return frame.patch(x0, y0, x1 - x0, y1 - y0)
