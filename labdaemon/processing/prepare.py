"""A camera's sharp frames, read once for all captures: its targets, its control targets, its orientation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labdaemon.blur import (
    TEXTURE_MAP,
    Dot,
    FloatArray,
    Patch,
    SharpTarget,
    fit_sharp,
    solved,
    unmeasurable_target,
)
from labdaemon.errors import DataError, UsageError
from labdaemon.flags import Flag
from labdaemon.geometry import Lens, Orientation, OrientedCamera, orient
from labdaemon.imaging import RawFrame, find_dots, mean_frame, read_frame
from labdaemon.processing.control import TAG_FAMILY, ControlTargets, find_control, surveyed_outlines
from labdaemon.processing.naming import names_in_image
from labdaemon.processing.patches import cut_patches, without_patches
from labdaemon.processing.survey import PatchBox, SurveyedPoint
from labdaemon.processing.target_search import ExpectedTarget, measure_contrast
from labdaemon.processing.thumbnails import Thumbnail

LEAST_CONTROL = 4  # three points leave four solutions
ORDINARY_PX = (12.0, 200.0)
"""Diameters of dots that are searched where their size and distance are unknown."""
LEAST_BLURRED, BLURRED_SHARE = 2, 0.2
"""Number and share of blurred dots from which a whole sharp frame counts as blurred."""
SMALLEST_PX = 7.0
"""Diameter below which a dot cannot be distinguished from anything else."""


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
    diameters_mm
        Sizes of the dots in use.
    volume
        True when several cameras intersect, so that control in one plane will not do.
    """

    lens: Lens
    control: tuple[SurveyedPoint, ...]
    family: str
    size_mm: float
    diameters_mm: tuple[float, ...]
    volume: bool


@dataclass(frozen=True, slots=True, eq=False)
class PreparedCamera:
    """Everything about a camera that stays for a campaign. Picklable.

    Attributes
    ----------
    name
        The camera's, empty where there is only one image.
    file
        Its (first) sharp frame.
    image_size
        (width, height).
    targets
        The dots at rest, and after them the textured patches.
    expected
        The dots as the search in blurred frames wants them.
    control
        Its control targets.
    orientation
        Where it stands; None without a survey.
    thumbnails
        Textured patches as small images, to be located in later frames.
    dots
        Each dot as found and the part of the first sharp frame that holds it: what the published method starts from.
        Empty unless asked for.
    notes
        What a person should know of its sharp frames, one line each.
    at_rest
        Whether the structure rests in them.
    """

    name: str
    file: Path
    image_size: tuple[int, int]
    targets: tuple[SharpTarget, ...]
    expected: tuple[ExpectedTarget, ...]
    control: ControlTargets
    orientation: Orientation | None = None
    thumbnails: tuple[Thumbnail, ...] = ()
    dots: tuple[tuple[Dot, Patch], ...] = ()
    notes: tuple[str, ...] = ()
    at_rest: bool = True

    @property
    def centres_px(self) -> FloatArray:
        """(n, 2) of the targets."""
        return np.array([target.centre_px for target in self.targets]).reshape(-1, 2)

    @property
    def dot_targets(self) -> tuple[SharpTarget, ...]:
        """Those that are dots."""
        return self.targets[: len(self.expected)]

    @property
    def patch_targets(self) -> tuple[SharpTarget, ...]:
        """Those that are textured patches."""
        return self.targets[len(self.expected) :]

    @property
    def view(self) -> OrientedCamera:
        """Where it stands; only for a camera that was oriented."""
        if self.orientation is None:
            raise UsageError(f"camera {self.name or self.file.name} was not oriented: it has no survey")
        return self.orientation.camera

    def renamed(self, keep: Sequence[int], names: Sequence[str]) -> PreparedCamera:
        """The same camera with only these dots, in this order, under these names, and its patches."""
        targets = tuple(replace(self.targets[i], name=name) for i, name in zip(keep, names, strict=True))
        dots = tuple(self.dots[i] for i in keep) if self.dots else ()
        expected = tuple(self.expected[i] for i in keep)
        return replace(self, targets=targets + self.patch_targets, expected=expected, dots=dots)


def prepare_camera(
    name: str,
    files: Sequence[Path],
    *,
    at_rest: bool = True,
    survey: CameraSurvey | None = None,
    keep_dots: bool = False,
    patches: Sequence[PatchBox] = (),
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
    keep_dots
        Keep what the published method needs.
    patches
        Textured patches to measure besides dots, which then may be none.

    Raises
    ------
    DataError
        A frame cannot be read or has another size; no dots and no patches; too few control targets, or ones that do
        not fit; a patch that cannot be used.
    """
    size = survey.lens.image_size if survey is not None else None
    frames = [read_frame(file, expect_size=size) for file in (files if at_rest else files[:1])]
    prepared = prepare_frames(name, frames, survey=survey, keep_dots=keep_dots, patches=patches)
    return replace(prepared, at_rest=at_rest)


def prepare_frames(
    name: str,
    frames: Sequence[RawFrame],
    *,
    survey: CameraSurvey | None = None,
    keep_dots: bool = False,
    patches: Sequence[PatchBox] = (),
) -> PreparedCamera:
    """Prepare a camera from sharp frames of one set that are already read; otherwise as `prepare_camera`."""
    file = frames[0].path
    frame = mean_frame(frames)
    grey = frame.grey()
    orientation, sizes = None, ORDINARY_PX
    if survey is None:
        control = find_control(frame, frames, grey, TAG_FAMILY)
    else:
        known = [point.name for point in survey.control]
        control = find_control(frame, frames, grey, survey.family, lens=survey.lens, known=known)
        _check_control_count(control, survey, file, frame)
        orientation = _orient(control, survey, file)
        sizes = _expected_diameters_px(orientation.camera, survey)
    taken = [*control.outlines, *control.other_outlines]
    if survey is not None and orientation is not None:
        taken += surveyed_outlines(orientation.camera, survey.control, survey.size_mm, survey.family)
    dots = find_dots(grey, diameter_range_px=sizes, exclude=taken)
    if not dots and sizes != ORDINARY_PX:
        dots = find_dots(grey, exclude=taken)  # of other sizes than the rig file says: for a better message
    dots, notes = without_patches(name, dots, patches, control, frame)
    if not dots and not patches:
        cause = f"; {frame.notes[0]}" if frame.notes else ""
        raise DataError(
            f"no dots found in this sharp frame: dark discs of 12 to 200 px on white paper are needed{cause}",
            file=file,
        )
    fitted = [(dot, _fit_or_flag(dot, frames)) for dot in dots]
    if not any(target.usable for _, target in fitted):
        if not patches:
            raise DataError("none of its dots can be measured: too dark, too light or not sharp", file=file)
        fitted = []
    usable = _flag_blurred_set(fitted)
    textures = cut_patches(frames, grey, patches)
    plain = [ExpectedTarget(t.centre_px, d.semi_major_px, d.semi_minor_px, d.angle_rad, 1.0) for d, t in usable]
    contrast = measure_contrast(frame.lazy_grey(), plain)
    return PreparedCamera(
        name,
        file,
        frame.size,
        (*(target for _, target in usable), *(target for target, _ in textures)),
        tuple(replace(one, contrast=float(c)) for one, c in zip(plain, contrast, strict=True)),
        control,
        orientation,
        thumbnails=tuple(thumbnail for _, thumbnail in textures),
        dots=tuple((dot, _cut_dot(dot, frames[0])) for dot, _ in usable) if keep_dots else (),
        notes=(*frame.notes, *notes),
    )


def name_dots(camera: PreparedCamera) -> PreparedCamera:
    """The same camera with its dots named by their place in the image, in reading order."""
    names = names_in_image(camera.centres_px[: len(camera.expected)])
    order = sorted(range(len(names)), key=names.__getitem__)
    return camera.renamed(order, [names[index] for index in order])


def prepare_patches(files: Sequence[Path], boxes: Sequence[tuple[int, int, int, int]]) -> PreparedCamera:
    """Take rectangles of sharp frames, whatever they show, for targets.

    Parameters
    ----------
    files
        Sharp frames, averaged.
    boxes
        (x, y, width, height) of each, px.

    Raises
    ------
    DataError
        A frame cannot be read, or a rectangle does not lie inside it.
    """
    return prepare_patch_frames([read_frame(file) for file in files], boxes)


def prepare_patch_frames(frames: Sequence[RawFrame], boxes: Sequence[tuple[int, int, int, int]]) -> PreparedCamera:
    """Prepare patches of sharp frames that are already read; otherwise as `prepare_patches`."""
    frame = mean_frame(frames)
    patches = [PatchBox(f"P{number:02d}", "", *box) for number, box in enumerate(boxes, start=1)]
    textures = cut_patches(frames, frame.grey(), patches)
    return PreparedCamera(
        "",
        frames[0].path,
        frame.size,
        tuple(target for target, _ in textures),
        (),
        ControlTargets(TAG_FAMILY),
        thumbnails=tuple(thumbnail for _, thumbnail in textures),
        notes=frame.notes,
    )


def _fit_or_flag(dot: Dot, frames: Sequence[RawFrame]) -> SharpTarget:
    """The dot's fit; where that has no solution a target at its place that only says so, for its row in the results."""
    target = solved(_fit)(dot, frames)
    if target is not None and target.usable:
        return target
    return unmeasurable_target(dot, frozenset() if target is None else target.flags)


def _flag_blurred_set(usable: list[tuple[Dot, SharpTarget]]) -> list[tuple[Dot, SharpTarget]]:
    """Flag all dots where so many are blurred that the structure was not at rest.

    A dot that moved by parts of a pixel while it was taken looks sharp, but what is measured against it is wrong.
    """
    blurred = sum(Flag.POOR_FIT in target.flags for _, target in usable)
    if blurred < max(LEAST_BLURRED, BLURRED_SHARE * len(usable)):
        return usable
    return [(dot, replace(target, flags=target.flags | {Flag.POOR_FIT})) for dot, target in usable]


def _check_control_count(control: ControlTargets, survey: CameraSurvey, file: Path, frame: RawFrame) -> None:
    if len(control.names) >= LEAST_CONTROL:
        return
    seen = f" ({', '.join(control.names)})" if control.names else ""
    raise DataError(
        f"{len(control.names)} of the {len(survey.control)} control targets of control.csv found in this frame{seen}, "
        f"at least {LEAST_CONTROL} are needed: check light, focus, [control] family and names"
        + (f"; {frame.notes[0]}" if frame.notes else ""),
        file=file,
    )


def _expected_diameters_px(view: OrientedCamera, survey: CameraSurvey) -> tuple[float, float]:
    """Diameters of dots, px, that may be seen near the control targets: nominal, nearer, farther, badly printed."""
    places = np.array([(point.x_mm, point.y_mm, point.z_mm) for point in survey.control])
    depth = view.to_camera_axes(places)[:, 2]
    focal = float(np.mean(view.lens.focal_px))
    smallest = 0.7 * min(survey.diameters_mm) * focal / float(depth.max())
    largest = 1.5 * max(survey.diameters_mm) * focal / float(depth.min())
    return max(smallest, SMALLEST_PX), max(largest, 2 * SMALLEST_PX)


def _cut_dot(dot: Dot, frame: RawFrame) -> Patch:
    """The part of a frame that holds a dot and its paper."""
    half = int(
        np.ceil(max(2.0 * dot.semi_major_px + 10, min(dot.paper_px, dot.semi_major_px + TEXTURE_MAP.max_radius_px)))
    )
    return frame.patch(round(dot.x_px) - half, round(dot.y_px) - half, 2 * half + 1, 2 * half + 1)


def _fit(dot: Dot, frames: Sequence[RawFrame]) -> SharpTarget:
    patches = [_cut_dot(dot, frame) for frame in frames]
    target = fit_sharp(dot, patches)
    if any(frame.is_white(patch) for frame, patch in zip(frames, patches, strict=True)):
        return replace(target, flags=target.flags | {Flag.SATURATED})
    return target


def _orient(control: ControlTargets, survey: CameraSurvey, file: Path) -> Orientation:
    points = {point.name: point for point in survey.control}
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
            side_px=control.side_px,
            side_mm=survey.size_mm,
        )
    except DataError as exc:
        raise DataError(str(exc), file=file) from None
