"""A camera's lens from a PhotoModeler calibration project's text export.

Its camera is in Brown's backward model, ours in OpenCV's forward one. Neither polynomial is the other's inverse, so
rather than translate coefficients the export's own points are adjusted again in our model, which gives its standard
deviations as well; without points the coefficients are fitted over the frame and the misfit is stated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry import (
    Lens,
    Network,
    adjust_without_gross_errors,
    forward_from_backward,
    read_photomodeler,
    select_observations,
)
from labdaemon.processing.calibration import MOST_GROSS_ERRORS, SD_PX, CameraCalibration, find_weaknesses, left_out_line


def calibrate_export(file: Path) -> CameraCalibration:
    """Adjust a PhotoModeler export in OpenCV's model, as a free network.

    Parameters
    ----------
    file
        The text export.

    Raises
    ------
    DataError
        It is no such export, or its points do not determine the lens.
    """
    try:
        project = read_photomodeler(file.read_text(encoding="utf-8", errors="replace"))
        lens, misfit = forward_from_backward(project.lens)
    except (DataError, OSError) as exc:
        raise DataError(str(exc), file=file) from exc
    if not len(project.image_px):
        return CameraCalibration(
            lens,
            np.full(9, np.nan),
            float("nan"),
            0,
            (),
            np.zeros((0, 2)),
            np.zeros((0, 2)),
            np.zeros(0, dtype=np.intp),
            (),
            (f"converted from Brown's model without its points: up to {misfit:.2g} px off in the frame",),
        )
    network = Network(
        (lens,),
        project.poses,
        np.zeros(len(project.poses), dtype=np.intp),
        project.points,
        project.image,
        project.point,
        project.image_px,
        SD_PX,
        free_interior=(np.ones(9, dtype=np.bool_),),
        datum=True,
    )
    try:
        network, names = select_observations(network, [str(number) for number in project.point_ids])
        adjustment, _, gross = adjust_without_gross_errors(network, names, max_errors=MOST_GROSS_ERRORS)
    except DataError as exc:
        raise DataError(str(exc), file=file) from exc
    final = adjustment.network
    adjusted = final.lenses[0]
    assert isinstance(adjusted, Lens)
    files = tuple(Path(name) for name in project.files)
    return CameraCalibration(
        adjusted,
        adjustment.interior_sd(),
        adjustment.sigma0 * SD_PX,
        adjustment.degrees_of_freedom,
        files,
        final.image_px,
        adjustment.residuals_px,
        final.image,
        tuple(left_out_line(error, files) for error in gross),
        tuple(find_weaknesses(adjusted, adjustment.interior_sd(), final.poses, final.image_px)),
    )
