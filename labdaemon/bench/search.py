"""What missing targets cost: a frame of many targets, of which some are covered completely."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labdaemon.bench.simulator import folder_maker
from labdaemon.blur import Measurement
from labdaemon.imaging import RawFrame, read_frame
from labdaemon.processing import PreparedCamera, measure_raw, prepare_sharp

FloatArray = NDArray[np.float64]
COVER_PX = 90
"""Side of the grey card over a covered target."""
SPOT_PX = 8.0
"""Size of the spots of a cluttered card: about that of a dot."""


@dataclass(frozen=True, slots=True)
class SearchResult:
    """One frame with covered targets.

    Attributes
    ----------
    covered
        Number of covered targets.
    seconds
        Processor time of the frame, of the fastest repetition: a busy machine does not change it much.
    measured
        Covered targets with numbers: none should have any.
    lost
        Uncovered targets without numbers.
    misplaced
        Uncovered targets found elsewhere than in the frame without covers.
    """

    covered: int
    seconds: float
    measured: int
    lost: int
    misplaced: int


def cover(frame: RawFrame, centres_px: FloatArray, *, reflectance: float = 0.35, clutter: float = 0.0) -> RawFrame:
    """The frame with a grey card over some places, (n, 2); `clutter` is the rms of dark and light spots on it."""
    values = frame.values.copy()
    height, width = values.shape
    for x, y in centres_px:
        half = COVER_PX // 2
        rows = slice(max(round(y) - half, 0), min(round(y) + half, height))
        columns = slice(max(round(x) - half, 0), min(round(x) + half, width))
        part = values[rows, columns]
        white = float(np.percentile(part, 90))
        rng = np.random.default_rng(round(x))
        card = reflectance * white + rng.normal(0, 3.0, part.shape)
        if clutter:
            spots = ndimage.gaussian_filter(rng.normal(size=part.shape), SPOT_PX)
            card = card + clutter * white * spots / spots.std()
        values[rows, columns] = np.clip(card, 0, white).astype(values.dtype)
    return replace(frame, values=values)


def shift_and_turn(frame: RawFrame, shift_px: tuple[int, int], turn_deg: float) -> RawFrame:
    """The frame of a camera that was pushed: moved by whole cells of the mosaic, turned about its middle."""
    period = frame.spacing
    planes = frame.values.astype(np.float32)
    result = planes.copy()
    for oy in range(period):
        for ox in range(period):
            plane = planes[oy::period, ox::period]
            h, w = plane.shape
            matrix = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), turn_deg, 1.0)
            matrix = matrix + np.array([[0.0, 0.0, shift_px[0] / period], [0.0, 0.0, shift_px[1] / period]])
            result[oy::period, ox::period] = cv2.warpAffine(plane, matrix, (w, h), borderMode=cv2.BORDER_REPLICATE)
    return replace(frame, values=np.asarray(result, dtype=np.float32))


def run_search_trials(
    camera: PreparedCamera,
    frame: RawFrame,
    counts: Sequence[int],
    *,
    repeats: int = 2,
    seed: int = 1,
    clutter: float = 0.0,
) -> list[SearchResult]:
    """Measure a frame with the first of `counts` targets covered, then the second, and so on."""
    rng = np.random.default_rng(seed)
    whole = measure_raw(camera, [frame], [None]).measurements
    places = np.array([one.centre_px for one in whole])
    order = [int(k) for k in rng.permutation(len(places)) if np.isfinite(places[k]).all()]
    results = []
    for count in counts:
        hidden = order[:count]
        covered = cover(frame, places[hidden], clutter=clutter) if count else frame
        seconds, found = _fastest(camera, covered, repeats)
        seen = np.array([one.centre_px for one in found])
        known = np.isfinite(seen).all(axis=1)
        open_ = [k for k in order if k not in hidden]
        away = np.hypot(*(seen - places).T)
        results.append(
            SearchResult(
                count,
                seconds,
                int(np.count_nonzero(known[hidden])),
                int(np.count_nonzero(~known[open_])),
                sum(bool(known[k]) and float(away[k]) > 3.0 for k in open_),
            )
        )
    return results


def _fastest(camera: PreparedCamera, frame: RawFrame, repeats: int) -> tuple[float, tuple[Measurement, ...]]:
    best = float("inf")
    for _ in range(repeats):
        begin = time.process_time()
        found = measure_raw(camera, [frame], [None]).measurements
        best = min(best, time.process_time() - begin)
    return best, found


def _report(name: str, results: Iterable[SearchResult], unpack_s: float, targets: int) -> None:
    first: SearchResult | None = None
    for one in results:
        first = first or one
        each = (one.seconds - first.seconds) / max(one.covered, 1)
        normal = first.seconds / targets
        click.echo(
            f"{name:8s} {one.covered:8d} {one.seconds:8.2f} {each:16.3f} {each / normal:16.1f} {each / unpack_s:12.2f}"
            f" {one.measured:9d} {one.lost:5d} {one.misplaced:10d}"
        )


@click.command("search")
@click.option("--targets", default=60, show_default=True)
@click.option("--seed", default=1, show_default=True)
def command(targets: int, seed: int) -> None:
    """Covered targets: what each costs, and whether the others are still found."""
    with tempfile.TemporaryDirectory() as name:
        options = {"cameras": 1, "size": "d80", "nef": True, "targets": targets, "amplitude_mm": (0.02, 2.5)}
        folder = folder_maker()(Path(name) / "set", seed=seed, **options)
        camera = prepare_sharp(folder).cameras[0]
        begin = time.process_time()
        frame = read_frame(folder / "captures" / "c1" / f"{camera.name}.dng")
        unpack_s = time.process_time() - begin
        click.echo("frame     covered  seconds  s per covered  x per measured  x unpacking  measured  lost  misplaced")
        counts = [k for k in (0, 1, 5, targets // 2) if k <= targets]
        _report("as taken", run_search_trials(camera, frame, counts, seed=seed), unpack_s, targets)
        pushed = shift_and_turn(frame, (60, -44), 0.8)
        _report("pushed", run_search_trials(camera, pushed, counts, seed=seed), unpack_s, targets)
        cluttered = run_search_trials(camera, frame, counts[:3], seed=seed, clutter=0.17)
        _report("clutter", cluttered, unpack_s, targets)
