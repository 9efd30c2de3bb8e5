"""A sharp set, prepared: every target under one name in every camera, with its place in millimetres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import FloatArray
from labdaemon.errors import DataError
from labdaemon.flags import Flag
from labdaemon.geometry import Lens, Plane, fit_plane
from labdaemon.processing.correspond import DetectedDots, correspond, intersect_rays
from labdaemon.processing.folder import DataFolder, SharpFiles, open_folder
from labdaemon.processing.naming import keep_names, match_places, names_in_space, other_names
from labdaemon.processing.prepare import CameraSurvey, PreparedCamera, prepare_camera
from labdaemon.processing.stations import detected_dots, excluded, orient_cameras
from labdaemon.processing.survey import SurveyedPoint

SIZE_TOLERANCE = 0.25
"""Largest relative difference of a dot's size from nominal; others are clutter."""
SAME_PLACE_MM = 15.0
"""How far a target of a later sharp set may lie from its place in the first and keep its name."""
SD_BOX_PX = 2.0
"""How well the middles of a patch's boxes in several cameras show one point: a person draws them."""


@dataclass(frozen=True, slots=True, eq=False)
class SharpSet:
    """Everything that measuring captures needs of the sharp frames. Picklable.

    Attributes
    ----------
    name
        The set's, "" for the flat one.
    cameras
        Each with its targets named and in the order in which it sees them.
    targets
        All targets' names, in the order of reports: the dots, then the textured patches.
    places_mm
        (n, 3) where they are at rest; NaN where no camera or only one of several sees them.
    sure
        (n,) False where which dot of one camera is which of another is a guess.
    plane
        The plane of motion, with one camera.
    covariance
        (6 c, 6 c) joint covariance of the cameras' exterior orientations, with several.
    control
        The survey.
    method
        How frames are to be measured.
    notes
        What a person should know: control targets left out, dots left over.
    sd_point_px
        Of each patch that several cameras see: how well the middles of its boxes show one point of the structure.
    """

    name: str
    cameras: tuple[PreparedCamera, ...]
    targets: tuple[str, ...]
    places_mm: FloatArray
    sure: NDArray[np.bool_]
    plane: Plane | None
    covariance: FloatArray | None
    control: tuple[SurveyedPoint, ...]
    method: str
    notes: tuple[str, ...]
    sd_point_px: Mapping[str, float] = field(default_factory=dict)


def camera_survey(folder: DataFolder, camera: str) -> CameraSurvey:
    """What the folder's rig file and survey say of a camera."""
    settings = folder.rig.cameras[camera]
    assert settings.focal_px is not None
    assert settings.principal_point_px is not None
    lens = Lens(settings.image_size, settings.focal_px, settings.principal_point_px, settings.distortion)
    rig = folder.rig
    return CameraSurvey(
        lens, folder.control, rig.control.family, rig.control.size_mm, rig.targets.diameter_mm, len(rig.cameras) > 1
    )


def prepare_in_folder(folder: DataFolder, files: SharpFiles, camera: str) -> PreparedCamera:
    """Prepare one camera of a folder's sharp set; one task for a worker."""
    return prepare_camera(
        camera,
        files.frames[camera],
        at_rest=files.at_rest,
        survey=camera_survey(folder, camera),
        keep_dots=folder.rig.processing.method == "paper",
        patches=[one for one in folder.patches if one.camera == camera],
    )


def assemble(
    folder: DataFolder, files: SharpFiles, prepared: Sequence[PreparedCamera], *, like: SharpSet | None = None
) -> SharpSet:
    """Name the targets and match them between cameras.

    Parameters
    ----------
    folder, files
        Where the frames came from.
    prepared
        Its cameras.
    like
        The campaign's first set, whose names are kept by place.

    Raises
    ------
    DataError
        No target can be made of the dots seen, or the boxes of a patch do not show one place.
    """
    sizes = folder.rig.targets.diameter_mm
    plane = _plane(prepared[0], folder) if len(prepared) == 1 else None
    covariance, notes = None, [note for camera in prepared for note in excluded(camera)]
    if plane is None:
        prepared, covariance, notes = orient_cameras(folder, prepared, sizes, ties=files.at_rest)
    seen = [detected_dots(camera) for camera in prepared]
    if folder.targets:
        wanted = np.array([(t.x_mm, t.y_mm, t.z_mm) for t in folder.targets])
        dots = np.column_stack([match_places(camera, wanted) for camera in seen])
        names, sure = [t.name for t in folder.targets], np.ones(len(wanted), dtype=np.bool_)
        if not (dots >= 0).any():
            raise DataError(
                "no dot lies near any of these places: check their coordinates (millimetres, the survey's axes)",
                file=folder.root / "targets.csv",
            )
    elif plane is not None:
        keep = _select_by_size(seen[0], plane, sizes, folder, files)
        dots, sure = keep[:, None], np.ones(len(keep), dtype=np.bool_)
        names = []
    else:
        tracks = correspond(seen, sizes)
        if not tracks and not folder.patches:
            raise DataError(
                f"no dot of {prepared[0].name} meets one of {prepared[1].name} at the sizes in [targets] diameter_mm "
                f"({', '.join(f'{size:g}' for size in sizes)} mm): are the camera files swapped, or the sizes wrong?",
                file=prepared[0].file.parent,
            )
        dots = np.array([track.dots for track in tracks], dtype=np.intp).reshape(-1, len(prepared))
        sure = np.array([track.sure for track in tracks], dtype=np.bool_)
        names = []
    places = _object_places(prepared, _dot_pixels(prepared, dots), plane)
    notes = [*(note for camera in prepared for note in camera.notes), *notes]
    notes += _unused_dot_notes(prepared, dots) + _blurred_set_notes(prepared)
    if not names:
        names = names_in_space(places) if like is None else _keep_names(places, like, folder)
        names = other_names(names, {point.name for point in folder.control} | {patch.name for patch in folder.patches})
    order = np.argsort(names, kind="stable") if not folder.targets else np.arange(len(names))
    dots, places, sure, names = dots[order], places[order], sure[order], [names[i] for i in order]
    cameras = []
    for column, camera in enumerate(prepared):
        rows = np.flatnonzero(dots[:, column] >= 0)
        cameras.append(camera.renamed([int(i) for i in dots[rows, column]], [names[i] for i in rows]))
    patches = tuple(dict.fromkeys(one.name for one in folder.patches))
    patch_places, sd_point_px = _patch_places(cameras, patches, plane, folder)
    return SharpSet(
        files.name,
        tuple(cameras),
        (*names, *patches),
        np.concatenate((places, patch_places)),
        np.append(sure, np.ones(len(patches), dtype=np.bool_)),
        plane,
        covariance,
        folder.control,
        folder.rig.processing.method,
        tuple(notes),
        sd_point_px,
    )


def prepare_sharp(folder: Path, sharp: str | None = None, *, like: SharpSet | None = None) -> SharpSet:
    """Prepare a sharp set of a data-set folder from its files.

    Parameters
    ----------
    folder
        The data-set folder.
    sharp
        The set's name, None for the flat one.
    like
        The campaign's first set, whose names are kept.

    Raises
    ------
    DataError, ConfigError
        One line naming the file at fault.
    """
    opened = open_folder(folder)
    files = opened.sharp(sharp)
    return assemble(opened, files, [prepare_in_folder(opened, files, camera) for camera in files.frames], like=like)


def _plane(camera: PreparedCamera, folder: DataFolder) -> Plane:
    """The plane of the control targets, without those that the orientation left out."""
    orientation = camera.orientation
    assert orientation is not None
    points = {point.name: point for point in folder.control}
    used = np.flatnonzero(orientation.used)
    names = [orientation.names[i] for i in used]
    surveyed = [points[name] for name in names]
    try:
        return fit_plane(
            orientation.camera.lens,
            camera.control.centres_px[used],
            np.array([(point.x_mm, point.y_mm, point.z_mm) for point in surveyed]),
            names=names,
            sd_image_px=camera.control.sd_px[used],
            sd_object_mm=np.array([point.sd_mm for point in surveyed]),
        )
    except DataError as exc:
        raise DataError(str(exc), file=folder.root / "control.csv") from None


def _select_by_size(
    seen: DetectedDots, plane: Plane, sizes: tuple[float, ...], folder: DataFolder, files: SharpFiles
) -> NDArray[np.intp]:
    """Select the dots whose size in the plane is one of those in use."""
    if not len(seen.centres_px):
        return np.empty(0, dtype=np.intp)
    places = plane.to_object(plane.to_plane(seen.centres_px))
    depth = seen.view.to_camera_axes(places)[:, 2]
    diameter = 2 * seen.radius_px * depth / np.mean(seen.view.lens.focal_px)
    off = np.abs(np.log(diameter[:, None] / np.array(sizes)[None])).min(axis=1)
    keep = np.flatnonzero(off < np.log(1 + SIZE_TOLERANCE))
    if not keep.size and not folder.patches:
        raise DataError(
            f"diameter_mm is {', '.join(f'{size:g}' for size in sizes)}, but the dots of the sharp frame measure "
            f"{np.median(diameter):.3g} mm in the plane of the control targets",
            file=folder.root / "rig.toml",
        )
    return keep


def _keep_names(places: FloatArray, like: SharpSet, folder: DataFolder) -> list[str]:
    """Names of the dots of an earlier set at the same places; its patches keep their own."""
    patches = {one.name for one in folder.patches}
    dots = [index for index, name in enumerate(like.targets) if name not in patches]
    return keep_names(places, like.places_mm[dots], tuple(like.targets[index] for index in dots), SAME_PLACE_MM)


def _dot_pixels(prepared: Sequence[PreparedCamera], dots: NDArray[np.intp]) -> FloatArray:
    """(c, n, 2) of n targets by the (n, c) index of each one's dot; NaN where a camera does not see it."""
    pixels = np.full((len(prepared), len(dots), 2), np.nan)
    for c, camera in enumerate(prepared):
        rows = np.flatnonzero(dots[:, c] >= 0)
        pixels[c, rows] = camera.centres_px[dots[rows, c]]
    return pixels


def _object_places(prepared: Sequence[PreparedCamera], pixels: FloatArray, plane: Plane | None) -> FloatArray:
    if plane is None:
        return intersect_rays([camera.view for camera in prepared], pixels)
    places = np.full((pixels.shape[1], 3), np.nan)
    rows = np.flatnonzero(np.isfinite(pixels[0]).all(axis=1))
    places[rows] = plane.to_object(plane.to_plane(pixels[0, rows]))
    return places


def _patch_places(
    cameras: Sequence[PreparedCamera], patches: Sequence[str], plane: Plane | None, folder: DataFolder
) -> tuple[FloatArray, dict[str, float]]:
    """(n, 3) places of the textured patches, and how well the boxes of each one show one point, px."""
    pixels, half = np.full((len(cameras), len(patches), 2), np.nan), np.full(len(patches), np.inf)
    for c, camera in enumerate(cameras):
        for one in camera.patch_targets:
            row = patches.index(one.name)
            pixels[c, row] = one.centre_px
            half[row] = min(half[row], *one.form.half_size_px)
    places = _object_places(cameras, pixels, plane)
    if plane is not None:
        return places, {}
    apart = np.stack([camera.view.project(places) for camera in cameras]) - pixels
    sd_point_px = {}
    for row, name in enumerate(patches):
        miss = float(np.nanmax(np.hypot(*apart[:, row].T), initial=0.0))
        if miss > half[row]:
            raise DataError(
                f"the boxes of {name} do not show one place: their rays miss it by {miss:.0f} px; draw each around "
                "the same part of the surface",
                file=folder.root / "patches.csv",
            )
        sd_point_px[name] = max(SD_BOX_PX, miss)
    return places, sd_point_px


def _blurred_set_notes(prepared: Sequence[PreparedCamera]) -> list[str]:
    return [
        f"{camera.name}: {camera.file.name} is itself blurred, so that everything measured against it is flagged "
        "poor_fit: take it at rest, or with a fast shutter (at_rest = false in set.toml)"
        for camera in prepared
        if len(camera.dot_targets) > 1 and all(Flag.POOR_FIT in target.flags for target in camera.dot_targets)
    ]


def _unused_dot_notes(prepared: Sequence[PreparedCamera], dots: NDArray[np.intp]) -> list[str]:
    notes = []
    for c, camera in enumerate(prepared):
        alone = sorted(set(range(len(camera.dot_targets))) - set(dots[:, c].tolist()))
        if alone:
            where = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in camera.centres_px[alone[:5]])
            more = " …" if len(alone) > 5 else ""
            notes.append(
                f"{camera.name}: {len(alone)} dot(s) not used, no partner or not a target's size: {where}{more}"
            )
    return notes
