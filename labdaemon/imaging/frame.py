"""A camera's file as linear sensor values: what every later step measures on.

Values stay the sensor's own counts, undemosaiced: demosaicing invents edge gradients and a tone curve breaks the
proportion between time and darkness. The colour filter is only a gain per channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import FloatArray, Patch
from labdaemon.errors import DataError
from labdaemon.imaging.hot_pixels import isolated, within_neighbours
from labdaemon.imaging.lazy_image import LazyImage

SATURATION_MARGIN = 0.01
"""Fraction of the range below white level from where on a pixel no longer counts as linear."""

WHITE_PART = 0.35
"""Part of a patch, in every channel, from which its paper counts as saturated: paper fills more than half of most."""

Grey = NDArray[np.float32]
T = TypeVar("T", bound=np.generic)

CELLS = 50_000
"""About so many cells of the mosaic give a frame's colours and brightness."""


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One camera's frame, or the mean of several.

    Attributes
    ----------
    path
        Where it was read from (the first file of a mean).
    values
        (h, w) counts as the sensor gave them, black not subtracted; uint16, or float32 for a mean of frames.
    pattern
        (ph, pw) uint8, repeated over the frame from its top-left pixel: each pixel's colour channel, 0 throughout for
        a grey sensor, 0..3 for a Bayer mosaic, where the two greens are two channels.
    black
        (bh, bw) float64, repeated likewise: black level, DN. Some files carry one value for every pixel.
    white_level
        Counts at which the file says that the sensor or its converter clips.
    ceilings_dn
        (channels,) counts at which each channel clips, or from which it compresses, by the frame's own values; inf
        where they do not show it, None where it was not looked for.
    masked
        (h, w) bool of pixels known to be unusable (clipped in one of the averaged frames), or None.
    frames
        How many frames were averaged; the noise variance is that of one divided by it.
    taken_at, serial, exposure_s
        From the file's metadata: the camera's clock, the body's serial number, the exposure; None or empty if absent.
    notes
        What a person should know of the file, one line each.
    is_raw
        Whether the values are the sensor's own; those of other files may have a tone curve.
    """

    path: Path
    values: NDArray[np.uint16] | Grey
    pattern: NDArray[np.uint8]
    black: FloatArray
    white_level: float
    masked: NDArray[np.bool_] | None = None
    frames: int = 1
    taken_at: datetime | None = None
    serial: str = ""
    exposure_s: float | None = None
    ceilings_dn: FloatArray | None = None
    notes: tuple[str, ...] = ()
    is_raw: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """(width, height), as `image_size` in a rig file."""
        height, width = self.values.shape
        return width, height

    @property
    def channels(self) -> int:
        """Number of colour channels: 1 for a grey sensor, 4 for a Bayer mosaic."""
        return int(self.pattern.max()) + 1

    @property
    def spacing(self) -> int:
        """Distance to the next pixel of the same colour in a row, px."""
        return 2 if self.channels > 1 else 1

    @property
    def clip_dn(self) -> FloatArray:
        """(ph, pw) counts at which each pixel of the repeating cell clips: white level or lower ceiling."""
        if self.ceilings_dn is None:
            return np.full(self.pattern.shape, self.white_level)
        return np.minimum(self.ceilings_dn, self.white_level)[self.pattern]

    @property
    def saturation_dn(self) -> FloatArray:
        """(ph, pw) counts (black included) from which each pixel of the repeating cell is taken as saturated."""
        clip = self.clip_dn
        return clip - SATURATION_MARGIN * (clip - float(self.black.mean()))

    def saturated(self) -> NDArray[np.bool_]:
        """(h, w) bool: clipped, here or in one of the averaged frames."""
        clipped = self._reaches(self.saturation_dn, self.values, 0, 0)
        return clipped if self.masked is None else clipped | self.masked

    def _reaches(self, level: FloatArray, values: NDArray[Any], x0: int, y0: int) -> NDArray[np.bool_]:
        """(h, w) bool of values of a part of the frame that reach a level given for the repeating cell."""
        first = level[0, 0]
        limit = first if (level == first).all() else _tile(level, x0, y0, values.shape[1], values.shape[0])
        return np.asarray(values >= limit)

    def channel(self, x0: int, y0: int, w: int, h: int) -> NDArray[np.uint8]:
        """(h, w) colour channel of each pixel of a rectangle, which may reach beyond the frame."""
        return _tile(self.pattern, x0, y0, w, h)

    def patch(self, x0: int, y0: int, w: int, h: int) -> Patch:
        """Cut a rectangle: counts above black, with saturated, hot and off-frame pixels marked invalid.

        Parameters
        ----------
        x0, y0
            Its top-left pixel in the frame; may be negative.
        w, h
            Its size, px.
        """
        width, height = self.size
        # Two more pixels all round, so that a hot pixel at the rim has neighbours of its own colour to differ from.
        ax, ay, bx, by = (max(x0 - 2, 0), max(y0 - 2, 0), min(x0 + w + 2, width), min(y0 + h + 2, height))
        values, valid = np.zeros((h, w)), np.zeros((h, w), dtype=np.bool_)
        if bx > ax and by > ay:
            raw = self.values[ay:by, ax:bx]
            good = ~self._reaches(self.saturation_dn, raw, ax, ay)
            if self.masked is not None:
                good &= ~self.masked[ay:by, ax:bx]
            light = raw - _tile(self.black, ax, ay, bx - ax, by - ay)
            good &= ~isolated(light, self.spacing, good)
            ty, tx = slice(max(ay, y0) - y0, min(by, y0 + h) - y0), slice(max(ax, x0) - x0, min(bx, x0 + w) - x0)
            sy, sx = slice(max(ay, y0) - ay, min(by, y0 + h) - ay), slice(max(ax, x0) - ax, min(bx, x0 + w) - ax)
            if tx.stop > tx.start and ty.stop > ty.start:
                values[ty, tx], valid[ty, tx] = light[sy, sx], good[sy, sx]
        return Patch(values=values, channel=self.channel(x0, y0, w, h), valid=valid, origin_px=(x0, y0))

    def is_white(self, patch: Patch) -> bool:
        """Whether so much of a patch of this frame is saturated, in every channel, that none shows the paper."""
        (x0, y0), (height, width) = patch.origin_px, patch.shape
        left, top = max(x0, 0), max(y0, 0)
        part = self.values[top : max(y0 + height, top), left : max(x0 + width, left)]
        if not part.size:
            return False
        saturated = self._reaches(self.saturation_dn, part, left, top)
        channel = self.channel(left, top, part.shape[1], part.shape[0])
        return all(saturated[channel == one].mean() > WHITE_PART for one in np.unique(channel))

    def whole(self) -> Patch:
        """The whole frame as one patch (80 bytes a pixel: for small frames and notebooks)."""
        width, height = self.size
        return self.patch(0, 0, width, height)

    def gains(self) -> FloatArray:
        """(channels,) factor for each colour channel (at least 1) that makes the frame's bright neutral surfaces grey.

        Estimated on cells of the mosaic between the 70th and the 99th percentile of brightness and below saturation, as
        the median ratio of the cells' mean to the channel: white paper is what is bright in these scenes.
        """
        return self._gains(self._cells()) if self.channels > 1 else np.ones(1)

    def _cells(self) -> FloatArray:
        """(pixels of a cell, n) counts of cells of the mosaic all over the frame."""
        ph, pw = self.pattern.shape
        height, width = self.values.shape
        step = max(1, int(np.sqrt(height * width / (ph * pw) / CELLS)))
        rows = slice(0, height // ph * ph)
        cols = slice(0, width // pw * pw)
        cells = self.values[rows, cols].reshape(height // ph, ph, width // pw, pw)[::step, :, ::step, :]
        return cells.transpose(1, 3, 0, 2).reshape(ph * pw, -1).astype(np.float64)

    def _gains(self, cells: FloatArray) -> FloatArray:
        black = _tile(self.black, 0, 0, *self.pattern.shape[::-1]).ravel()
        usable = (cells < self.saturation_dn.reshape(-1, 1)).all(axis=0)
        light = (cells - black[:, None])[:, usable]
        if light.shape[1] < 16:
            return np.ones(self.channels)
        mean = light.mean(axis=0)
        low, high = np.percentile(mean, (70.0, 99.0))
        bright = (mean >= low) & (mean <= high) & (mean > 0)
        result = np.ones(self.channels)
        for place, channel in enumerate(self.pattern.ravel()):
            ratio = np.median(light[place, bright] / mean[bright]) if bright.any() else 1.0
            result[channel] = 1.0 / ratio if ratio > 0.02 else 1.0
        return np.asarray(result / result.min())

    def grey(self) -> Grey:
        """(h, w) float32: the mosaic as one image at full resolution, in parts of the range from black to white.

        For finding things and drawing them; measurements are made on `patch`. Each channel is multiplied by its gain
        and the result clipped at 1, since beyond it some channel may have clipped.
        """
        return self.lazy_grey()[:, :]

    def lazy_grey(self) -> LazyImage:
        """The same image as `grey`, computed only where it is cut."""
        height, width = self.values.shape
        cells = self._cells()
        gains = self._gains(cells) if self.channels > 1 else np.ones(1)
        # Where any channel may have clipped, all are shown as white.
        scale = gains[self.pattern]
        scale = scale / float((scale * (self.clip_dn - float(self.black.mean()))).min())
        black = _tile(self.black, 0, 0, *self.pattern.shape[::-1])
        sample = np.minimum((cells - black.reshape(-1, 1)) * scale.reshape(-1, 1), 1.0).mean(axis=0)
        everywhere = self.black.shape == self.values.shape
        shape = scale.shape
        if not everywhere:
            shape = (np.lcm(shape[0], self.black.shape[0]), np.lcm(shape[1], self.black.shape[1]))
        period = int(shape[0])
        scales = _tile(scale, 0, 0, width, period).astype(np.float32)
        offsets = _tile(self.black, 0, 0, width, period).astype(np.float32)

        def make(x0: int, y0: int, x1: int, y1: int) -> Grey:
            # Two more pixels all round: neighbours of the same colour.
            left, top = max(x0 - 2, 0), max(y0 - 2, 0)
            near = within_neighbours(self.values[top : y1 + 2, left : x1 + 2], self.spacing)
            near = near[y0 - top : y1 - top, x0 - left : x1 - left]
            out = np.empty(near.shape, dtype=np.float32)
            if everywhere:
                np.subtract(near, self.black[y0:y1, x0:x1], out=out, casting="unsafe")
            for row in range(period):
                line = (y0 + row) % period
                if not everywhere:
                    np.subtract(near[row::period], offsets[line, x0:x1], out=out[row::period], dtype=np.float32)
                out[row::period] *= scales[line, x0:x1]
            return np.minimum(out, 1.0, out=out)

        return LazyImage((height, width), make, sample)


def _tile(pattern: NDArray[T], x0: int, y0: int, w: int, h: int) -> NDArray[T]:
    """Repeat `pattern`, whose origin is pixel (0, 0), over a rectangle."""
    ph, pw = pattern.shape
    # One axis after the other: whole rows are copied at once.
    result: NDArray[T] = pattern.take(np.arange(x0, x0 + w) % pw, axis=1).take(np.arange(y0, y0 + h) % ph, axis=0)
    return result


def mean_frame(frames: Sequence[RawFrame]) -> RawFrame:
    """Average sharp frames of one set: same camera, nothing moved.

    Raises
    ------
    DataError
        The frames differ in size, colour filter or white level.
    """
    first = frames[0]
    if len(frames) == 1:
        return first
    for other in frames[1:]:
        if other.size != first.size:
            raise DataError(
                f"is {other.size[0]}x{other.size[1]}, but {first.path.name} of the same set is "
                f"{first.size[0]}x{first.size[1]}; only frames of one camera are averaged",
                file=other.path,
            )
        if not np.array_equal(other.pattern, first.pattern) or other.white_level != first.white_level:
            raise DataError(
                f"comes from another sensor than {first.path.name}; keep them in separate sets", file=other.path
            )
    ceilings = [frame.ceilings_dn for frame in frames if frame.ceilings_dn is not None]
    total = np.zeros(first.values.shape, dtype=np.float32)
    masked = np.zeros(first.values.shape, dtype=np.bool_)
    for frame in frames:
        total += frame.values
        masked |= frame.saturated()
    return replace(
        first,
        values=total / np.float32(len(frames)),
        masked=masked,
        frames=len(frames),
        ceilings_dn=np.min(ceilings, axis=0) if ceilings else None,
        notes=tuple(note for frame in frames for note in frame.notes),
    )
