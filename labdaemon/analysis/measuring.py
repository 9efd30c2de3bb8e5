"""Two photographs, motion in pixels: what `labdaemon measure` does, for notebooks."""

from __future__ import annotations

from collections.abc import Sequence

from labdaemon.analysis.arrays import FrameLike, as_frames
from labdaemon.analysis.motion_table import MotionTable
from labdaemon.blur import ExposureWindow
from labdaemon.errors import UsageError
from labdaemon.processing import measure_raw, name_dots, prepare_frames, prepare_patch_frames

Box = tuple[int, int, int, int]


def measure(
    sharp: FrameLike | Sequence[FrameLike],
    blurred: FrameLike | Sequence[FrameLike],
    *,
    window: ExposureWindow | Sequence[ExposureWindow] | None = None,
    patches: Sequence[Box] = (),
    method: str = "fit",
) -> MotionTable:
    """Measure the motion of every dot, or of every patch, from a sharp and a blurred image.

    Parameters
    ----------
    sharp
        Image at rest: a path, a frame, or an (h, w) array of linear values. Several images are averaged.
    blurred
        Image with the shutter open during the vibration. Several images are the captures of one group; they are
        measured together, and each needs its window.
    window
        Frequency, exposure and phase of the exposure; None assumes whole cycles. For a group one element per image.
    patches
        Rectangles (x, y, width, height) of the sharp image, px, that are measured instead of dots. They can show any
        texture.
    method
        "fit", or "paper" for the method as published in McCarthy (2016).

    Returns
    -------
    MotionTable
        One `Measurement` per target, in reading order. Each has a name, ``amplitude_px``, ``sd_px`` and flags.

    Raises
    ------
    DataError
        A file cannot be read, there is no dot in the sharp image, or the images differ in size.
    UsageError
        An array is not usable, or windows and images do not match.

    Examples
    --------
    >>> import labdaemon as ld
    >>> motion = ld.measure("sharp.nef", "blurred.nef")              # doctest: +SKIP
    >>> motion["T01"].amplitude_px, motion["T01"].sd_px              # doctest: +SKIP
    (3.012, 0.004)
    """
    if method not in ("fit", "paper"):
        raise UsageError(f"method is 'fit' or 'paper', not {method!r}")
    rest, moving = as_frames(sharp, "sharp"), as_frames(blurred, "blurred")
    windows = _windows(window, len(moving))
    for frame in (*rest[1:], *moving):
        if frame.size != rest[0].size:
            width, height = rest[0].size
            raise UsageError(
                f"{frame.path} is {frame.size[0]}x{frame.size[1]} px, but the sharp image is {width}x{height} px; "
                "give images of one camera"
            )
    if patches:
        camera = prepare_patch_frames(rest, patches)
    else:
        camera = name_dots(prepare_frames("", rest, keep_dots=method == "paper"))
    result = measure_raw(camera, moving, windows, method=method)
    return MotionTable(moving[-1].path.stem, result.measurements)


def _windows(window: ExposureWindow | Sequence[ExposureWindow] | None, count: int) -> list[ExposureWindow | None]:
    if window is None:
        if count > 1:
            raise UsageError(
                f"{count} blurred images are a group; give one window for each, or measure them one by one"
            )
        return [None]
    windows = [window] if isinstance(window, ExposureWindow) else list(window)
    if len(windows) != count:
        raise UsageError(f"{count} blurred images need {count} windows, not {len(windows)}")
    return list(windows)
