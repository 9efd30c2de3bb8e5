"""Where several cameras stand: one survey, one adjustment, the targets at rest as ties between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur import FloatArray
from labdaemon.errors import DataError
from labdaemon.geometry import ControlPoint, ImageObservation, orient_jointly
from labdaemon.processing.correspond import DetectedDots, correspond
from labdaemon.processing.folder import DataFolder
from labdaemon.processing.prepare import PreparedCamera

SD_TIE_PX = 0.05
"""A dot's centre: fit, paper that is not flat, the shift of a circle's centre under perspective."""
TIE = "dot "
"""Before the name of a tie, so that it never is a control target's."""


def detected_dots(camera: PreparedCamera) -> DetectedDots:
    """A camera's dots at rest, for matching."""
    radius = np.array([target.semi_major_px for target in camera.expected])
    return DetectedDots(camera.view, camera.centres_px[: len(radius)], radius)


def excluded(camera: PreparedCamera) -> list[str]:
    """Control targets that a camera's own orientation left out, a line each."""
    if camera.orientation is None:
        return []
    return [
        f"{camera.name}: control target {name} left out, {reason}"
        for name, reason in camera.orientation.excluded.items()
    ]


def orient_cameras(
    folder: DataFolder, prepared: Sequence[PreparedCamera], sizes_mm: Sequence[float], *, ties: bool
) -> tuple[list[PreparedCamera], FloatArray, list[str]]:
    """Orient all cameras of a sharp set together.

    Parameters
    ----------
    folder
        Its survey.
    prepared
        The cameras, each oriented on its own.
    sizes_mm
        Diameters of the dots.
    ties
        Whether the structure rests, so that dots tie the cameras to each other.

    Returns
    -------
    cameras, covariance, notes
        The cameras with their joint orientation, its (6 c, 6 c) covariance, and what was left out.

    Raises
    ------
    DataError
        The control targets do not fit together.
    """
    control = [ControlPoint(p.name, np.array([p.x_mm, p.y_mm, p.z_mm]), p.sd_mm) for p in folder.control]
    observations = {camera.name: _control(camera) for camera in prepared}
    tracks = correspond([detected_dots(camera) for camera in prepared], sizes_mm) if ties else []
    for number, track in enumerate(track for track in tracks if track.sure):
        for camera, dot in zip(prepared, track.dots, strict=True):
            if dot >= 0:
                x, y = camera.centres_px[dot]
                observations[camera.name].append(ImageObservation(f"{TIE}{number}", float(x), float(y), SD_TIE_PX))
    try:
        together = orient_jointly(
            {camera.name: camera.view.lens for camera in prepared},
            observations,
            control,
            side_mm=folder.rig.control.size_mm,
        )
    except DataError as exc:
        raise DataError(str(exc), file=prepared[0].file.parent) from None
    cameras = [
        replace(camera, orientation=replace(together.orientations[camera.name], camera=together.cameras[camera.name]))
        for camera in prepared
    ]
    notes = [
        f"control target {name} left out, {reason}"
        for name, reason in together.excluded.items()
        if not name.startswith(TIE)
    ]
    return cameras, together.covariance, notes


def _control(camera: PreparedCamera) -> list[ImageObservation]:
    control = camera.control
    return [
        ImageObservation(name, float(x), float(y), float(sd), float(side))
        for name, (x, y), sd, side in zip(
            control.names, control.centres_px, control.sd_px, control.side_px, strict=True
        )
    ]
