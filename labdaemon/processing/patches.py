"""Textured patches of a camera's sharp frames: targets without a dot, where a person has drawn a box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from labdaemon.blur import Dot, FloatArray, SharpTarget, make_textured_patch, solved
from labdaemon.errors import DataError
from labdaemon.flags import Flag
from labdaemon.imaging import Grey, RawFrame
from labdaemon.processing.control import ControlTargets
from labdaemon.processing.survey import PatchBox
from labdaemon.processing.thumbnails import Thumbnail

LABEL_RADII = 4.0
"""A dot's label ends here at the latest, in radii of the dot: where all is paper its end does not show."""


def cut_patches(
    frames: Sequence[RawFrame], grey: Grey, boxes: Sequence[PatchBox]
) -> list[tuple[SharpTarget, Thumbnail]]:
    """Take rectangles of sharp frames, whatever they show, for targets.

    Parameters
    ----------
    frames, grey
        Sharp frames, averaged, and their mean as a grey image.
    boxes
        One a patch.

    Raises
    ------
    DataError
        A rectangle does not lie inside the frame, or has no values that can be used.
    """
    width, height = frames[0].size
    cut = []
    for one in boxes:
        x, y, w, h = one.box
        what = f"patch {one.name} ({one.place})" if one.camera else f"patch {one.place}"
        if x < 0 or y < 0 or x + w > width or y + h > height:
            raise DataError(f"{what} does not lie inside the frame of {width}x{height} px", file=frames[0].path)
        # What lies outside the box is blurred into it.
        reach = max(16, min(64, max(w, h) // 2))
        x0, y0, x1, y1 = max(x - reach, 0), max(y - reach, 0), min(x + w + reach, width), min(y + h + reach, height)
        cuts = [frame.patch(x0, y0, x1 - x0, y1 - y0) for frame in frames]
        target = solved(make_textured_patch)(cuts, one.box, name=one.name)
        if target is None:
            raise DataError(
                f"{what} cannot be used: its sharp image has no values that can be interpolated; choose one that is "
                "neither clipped nor empty",
                file=frames[0].path,
            )
        if any(frame.is_white(frame.patch(*one.box)) for frame in frames):
            target = replace(target, flags=target.flags | {Flag.SATURATED})
        cut.append((target, Thumbnail.cut(grey, one.box)))
    return cut


def without_patches(
    camera: str, dots: Sequence[Dot], boxes: Sequence[PatchBox], control: ControlTargets, frame: RawFrame
) -> tuple[list[Dot], list[str]]:
    """The dots that no patch holds, and notes of those that one holds or touches.

    Parameters
    ----------
    camera
        Its name.
    dots, control
        What its sharp frame shows.
    boxes
        The patches: blobs of a texture look like dots, and what a person calls a patch is measured as one.
    frame
        The sharp frame.

    Raises
    ------
    DataError
        A patch reaches onto a control target, which does not move.
    """
    notes = []
    kept = list(dots)
    for one in boxes:
        for name, outline in zip(control.names, control.outlines, strict=True):
            if _overlaps(one, outline):
                raise DataError(
                    f"patch {one.name} ({one.place}) reaches onto control target {name}, which does not move: "
                    "move the box, or make it smaller",
                    file=frame.path,
                )
        held = [dot for dot in kept if _distance(one, dot) <= 0]
        kept = [dot for dot in kept if _distance(one, dot) > 0]
        touched = [dot for dot in kept if _distance(one, dot) < min(dot.paper_px, LABEL_RADII * dot.semi_major_px)]
        for seen, what in (
            (held, "lies in patch {} and is not measured by itself"),
            (touched, "has its label partly in patch {}: a label that moves by itself spoils the patch"),
        ):
            for dot in seen:
                notes.append(f"{camera}: the dot at ({dot.x_px:.0f}, {dot.y_px:.0f}) {what.format(one.name)}")
    return kept, notes


def _distance(box: PatchBox, dot: Dot) -> float:
    """Distance of a dot's centre from a box, px; 0 inside."""
    x, y, w, h = box.box
    aside = np.maximum(0.0, [x - dot.x_px, dot.x_px - x - w + 1, y - dot.y_px, dot.y_px - y - h + 1])
    return float(np.hypot(max(aside[:2]), max(aside[2:])))


def _overlaps(box: PatchBox, outline: FloatArray) -> bool:
    """Whether a box and a convex polygon (k, 2) have pixels in common."""
    x, y, w, h = box.box
    corners = np.array([(x, y), (x + w - 1, y), (x + w - 1, y + h - 1), (x, y + h - 1)], dtype=np.float32)
    hull = cv2.convexHull(np.asarray(outline, dtype=np.float32))
    return float(cv2.intersectConvexConvex(corners, hull)[0]) > 0
