"""What a camera's sharp frames say once for all captures: its targets, its control targets, where it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labdaemon.blur.fit_sharp import fit_sharp
from labdaemon.blur.pixels import Dot, FloatArray
from labdaemon.blur.sharp import SharpTarget
from labdaemon.blur.still import measure_still
from labdaemon.blur.texture import sharp_texture
from labdaemon.errors import DataError
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.orient import Orientation, orient
from labdaemon.imaging.codes import Tag, by_name, centre_of, find_tags
from labdaemon.imaging.dots import find_dots
from labdaemon.imaging.frame import Grey, RawFrame, mean_frame
from labdaemon.imaging.raw import read_frame
from labdaemon.processing.search import Sought, measure_contrast
from labdaemon.processing.survey import ControlPoint
from labdaemon.processing.thumbnails import Thumbnail

TAG_FAMILY = "apriltag-36h11"
LEAST_CONTROL = 4
SD_CENTRE_PX = 0.03
"""What a tag's centre is good to at best: print, paper that is not flat, lens model."""


@dataclass(frozen=True, slots=True)
class CameraSurvey:
    """What is known of a camera and its control targets before its frames are read.

    Attributes
    ----------
    lens
        Interior orientation.
    control
        Surveyed control targets of the whole rig.
    family, size_mm
        Their kind and size.
    volume
        True when several cameras intersect, so that control in one plane will not do.
    """

    lens: Lens
    control: tuple[ControlPoint, ...]
    family: str
    size_mm: float
    volume: bool


@dataclass(frozen=True, slots=True, eq=False)
class ControlTargets:
    """Control targets as a camera's sharp frame shows them.

    Attributes
    ----------
    names
        m names.
    centres_px
        (m, 2).
    sd_px
        (m,) of each coordinate.
    sharp
        What they look like, to be compared with later frames.
    thumbnails
        The same as small pictures, to be found again.
    own_blur_px2
        (m,) extra blur that each reads against its own sharp frame: what putting a mosaic's colours together costs. Zero
        for a perfect picture, and to be subtracted from what it reads against later frames.
    family
        Their kind.
    """

    names: tuple[str, ...]
    centres_px: FloatArray
    sd_px: FloatArray
    sharp: tuple[SharpTarget, ...]
    thumbnails: tuple[Thumbnail, ...]
    own_blur_px2: FloatArray
    family: str = TAG_FAMILY


@dataclass(frozen=True, slots=True, eq=False)
class PreparedCamera:
    """Everything about a camera that stays for a campaign. Picklable.

    Attributes
    ----------
    name
        The camera's, empty where there is only one picture.
    file
        Its (first) sharp frame.
    image_size
        (width, height).
    targets
        The dots, or textures, at rest.
    sought
        The same targets as the search in blurred frames wants them; empty for textures, which have `thumbnails`.
    control
        Its control targets.
    orientation
        Where it stands; None without a survey.
    """

    name: str
    file: Path
    image_size: tuple[int, int]
    targets: tuple[SharpTarget, ...]
    sought: tuple[Sought, ...]
    control: ControlTargets
    orientation: Orientation | None = None
    thumbnails: tuple[Thumbnail, ...] = ()

    @property
    def centres_px(self) -> FloatArray:
        """(n, 2) of the targets."""
        return np.array([target.centre_px for target in self.targets]).reshape(-1, 2)

    def renamed(self, keep: Sequence[int], names: Sequence[str]) -> PreparedCamera:
        """The same camera with only these targets, in this order, under these names."""
        targets = tuple(replace(self.targets[i], name=name) for i, name in zip(keep, names, strict=True))
        return replace(self, targets=targets, sought=tuple(self.sought[i] for i in keep))


def prepare_camera(
    name: str, files: Sequence[Path], *, at_rest: bool = True, survey: CameraSurvey | None = None
) -> PreparedCamera:
    """Find and fit targets and control targets in a camera's sharp frames, and orient it.

    Parameters
    ----------
    name
        The camera's.
    files
        Sharp frames of one set, averaged. Only the first is used where the structure does not rest.
    at_rest
        Whether the structure rests in them.
    survey
        Lens and surveyed control targets; None to work in pixels alone.

    Raises
    ------
    DataError
        A frame cannot be read or has another size; no dots; too few control targets, or ones that do not fit.
    """
    size = survey.lens.image_size if survey is not None else None
    frames = [read_frame(file, expect_size=size) for file in (files if at_rest else files[:1])]
    frame = mean_frame(frames)
    family = survey.family if survey is not None else TAG_FAMILY
    tags = list(by_name(find_tags(frame, family), where=str(files[0])).values())
    if survey is not None:
        known = {point.name for point in survey.control}
        tags = [tag for tag in tags if tag.name in known]
        _enough(tags, survey, files[0])
    grey = frame.grey()
    dots = find_dots(grey, exclude=[_widened(tag) for tag in tags])
    if not dots:
        raise DataError(
            "no dots found in this sharp frame: dark discs of 12 to 200 px on white paper are needed", file=files[0]
        )
    fitted = [(dot, _fit(dot, frames)) for dot in dots]
    usable = [(dot, target) for dot, target in fitted if target.usable]
    if not usable:
        raise DataError("none of its dots can be measured: too dark, too light or not sharp", file=files[0])
    control = _control(tags, frames, grey, family, survey)
    plain = [Sought(t.centre_px, d.semi_major_px, d.semi_minor_px, d.angle_rad, 1.0) for d, t in usable]
    contrast = measure_contrast(grey, plain)
    return PreparedCamera(
        name,
        Path(files[0]),
        frame.size,
        tuple(target for _, target in usable),
        tuple(replace(one, contrast=float(c)) for one, c in zip(plain, contrast, strict=True)),
        control,
        None if survey is None else _orient(control, tags, survey, files[0]),
    )


def prepare_patches(files: Sequence[Path], boxes: Sequence[tuple[int, int, int, int]]) -> PreparedCamera:
    """Take rectangles of sharp frames, whatever they show, for targets.

    Parameters
    ----------
    files
        Sharp frames, averaged.
    boxes
        (x, y, width, height) of each, px.
    """
    frames = [read_frame(file) for file in files]
    frame = mean_frame(frames)
    width, height = frame.size
    targets = []
    for number, (x, y, w, h) in enumerate(boxes, start=1):
        if x < 0 or y < 0 or x + w > width or y + h > height:
            raise DataError(f"patch {x},{y},{w},{h} does not lie inside the frame of {width}x{height} px", file=files[0])
        # What lies beside the box is smeared into it.
        reach = max(16, min(64, max(w, h) // 2))
        x0, y0, x1, y1 = max(x - reach, 0), max(y - reach, 0), min(x + w + reach, width), min(y + h + reach, height)
        cuts = [f.patch(x0, y0, x1 - x0, y1 - y0) for f in frames]
        targets.append(sharp_texture(cuts, (x, y, w, h), name=f"P{number:02d}"))
    nothing = ControlTargets((), np.empty((0, 2)), np.empty(0), (), (), np.empty(0))
    grey = frame.grey()
    thumbnails = tuple(Thumbnail.cut(grey, box) for box in boxes)
    return PreparedCamera("", Path(files[0]), frame.size, tuple(targets), (), nothing, thumbnails=thumbnails)


def _enough(tags: Sequence[Tag], survey: CameraSurvey, file: Path) -> None:
    if len(tags) >= LEAST_CONTROL:
        return
    seen = f" ({', '.join(tag.name for tag in tags)})" if tags else ""
    raise DataError(
        f"{len(tags)} of the {len(survey.control)} control targets of control.csv found in this sharp frame{seen}, "
        f"at least {LEAST_CONTROL} are needed: check light, focus, [control] family and names",
        file=file,
    )


def _widened(tag: Tag) -> FloatArray:
    """A tag's outline with its white rim."""
    middle = tag.corners_px.mean(axis=0)
    outline: FloatArray = middle + 1.15 * (tag.corners_px - middle)
    return outline


def _fit(dot: Dot, frames: Sequence[RawFrame]) -> SharpTarget:
    half = int(np.ceil(1.7 * dot.semi_major_px + 9))
    x, y = round(dot.x_px), round(dot.y_px)
    side = 2 * half + 1
    return fit_sharp(dot, [frame.patch(x - half, y - half, side, side) for frame in frames])


def _control(
    tags: Sequence[Tag], frames: Sequence[RawFrame], grey: Grey, family: str, survey: CameraSurvey | None
) -> ControlTargets:
    width, height = frames[0].size
    names, centres, sds, sharp, thumbnails, own = [], [], [], [], [], []
    for tag in tags:
        corners = tag.corners_px
        rim = 0.1 * float(np.hypot(*(corners[0] - corners[2])))
        low = np.maximum(np.floor(corners.min(axis=0) - rim).astype(int), 0)
        high = np.minimum(np.ceil(corners.max(axis=0) + rim).astype(int), (width - 1, height - 1))
        if (high - low).min() < 8:
            continue
        margin = 8
        x0, y0 = (int(v) for v in np.maximum(low - margin, 0))
        x1, y1 = (int(v) for v in np.minimum(high + margin, (width - 1, height - 1)))
        box = (int(low[0]), int(low[1]), int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
        cuts = [frame.patch(x0, y0, x1 - x0 + 1, y1 - y0 + 1) for frame in frames]
        texture = sharp_texture(cuts, box, name=tag.name)
        sharp.append(texture)
        own.append(measure_still(texture, cuts[0]).extra_blur_px2)
        thumbnails.append(Thumbnail.cut(grey, box))
        names.append(tag.name)
        centres.append(tag.centre_px if survey is None else _centre(tag, survey.lens))
        sds.append(np.hypot(tag.sd_px, SD_CENTRE_PX) if tag.measured else 0.3)
    return ControlTargets(tuple(names), np.array(centres).reshape(-1, 2), np.array(sds), tuple(sharp), tuple(thumbnails), np.array(own), family)


def _centre(tag: Tag, lens: Lens) -> FloatArray:
    """Centre of a tag on a lens that bends its sides."""
    slopes = lens.undistort(tag.corners_px)
    centre: FloatArray = lens.distort(centre_of(slopes)[None])[0]
    return centre if np.isfinite(centre).all() else tag.centre_px


def _orient(control: ControlTargets, tags: Sequence[Tag], survey: CameraSurvey, file: Path) -> Orientation:
    points = {point.name: point for point in survey.control}
    side = {tag.name: float(np.hypot(*(tag.corners_px - np.roll(tag.corners_px, 1, axis=0)).T).max()) for tag in tags}
    surveyed = [points[name] for name in control.names]
    try:
        return orient(
            survey.lens,
            control.centres_px,
            np.array([(point.x_mm, point.y_mm, point.z_mm) for point in surveyed]),
            names=control.names,
            sd_image_px=control.sd_px,
            sd_object_mm=np.array([point.sd_mm for point in surveyed]),
            volume=survey.volume,
            side_px=np.array([side[name] for name in control.names]),
            side_mm=survey.size_mm,
        )
    except DataError as exc:
        raise DataError(str(exc), file=file) from None
