"""How long measuring one frame takes on one core, and how that grows with targets and with blur."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import rawpy

from labdaemon.bench.simulator import folder_maker
from labdaemon.blur import Defocus, InitialGuess, measure_frame
from labdaemon.imaging import RawFrame, read_frame
from labdaemon.processing import (
    BlurredTarget,
    PreparedCamera,
    WorkerPool,
    frame_shift,
    locate_targets,
    measure_raw,
    open_folder,
    prepare_sharp,
)

T = TypeVar("T")

GOAL_S = 0.3  # stated for one core and the frame below, decode excluded
TARGETS = 60  # in a frame of ten megapixels
LARGEST_MM = 10.0 * 6.1 / 24.0
"""10 px of semi-amplitude at 1 m."""

LENGTHS_PX = (0.5, 2.5, 5.0, 10.0, 20.0)


@dataclass(frozen=True, slots=True)
class SpeedResult:
    """Processor times of the fastest of several runs, seconds.

    Attributes
    ----------
    unpack_s
        LibRaw's own time to open the file and unpack its values.
    decode_s
        The same with everything that turns it into a frame of ours.
    frame_s
        A frame measured, from values in memory to motions in pixels: finding targets again, camera shift, fits.
    fit_s
        The fits alone.
    by_targets
        (targets, fit seconds).
    by_length
        (semi-amplitude px, fit seconds for as many targets as `per_length`).
    per_length
        Targets in each of those.
    """

    targets: int
    unpack_s: float
    decode_s: float
    frame_s: float
    fit_s: float
    by_targets: list[tuple[int, float]]
    by_length: list[tuple[float, float]]
    per_length: int


def run_speed(seed: int, repeat: int) -> SpeedResult:
    """Render frames and time them in one process that has one core.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    folder_maker()
    with WorkerPool(1, deadline_s=900.0) as pool, tempfile.TemporaryDirectory() as place:
        return pool.submit(time_frames, Path(place), seed, repeat).result()


def time_frames(place: Path, seed: int, repeat: int) -> SpeedResult:
    """Do the timing; a worker's task, so that no other threads share the core."""
    common: dict[str, Any] = {"cameras": 1, "size": "d80", "seed": seed, "nef": True}
    folder = folder_maker()(place / "frame", targets=TARGETS, amplitude_mm=(0.02, LARGEST_MM), **common)
    opened = open_folder(folder)
    prepared = prepare_sharp(folder)
    camera = prepared.cameras[0]
    file = folder / "captures" / "c1" / f"{camera.name}.dng"
    window = opened.capture("c1").about.window(camera.name)
    unpack_s = _fastest(repeat, lambda: _unpack(file))
    decode_s = _fastest(repeat, lambda: read_frame(file))
    frame = read_frame(file)
    frame_s = _fastest(repeat, lambda: measure_raw(camera, [frame], [window], control=prepared.control))
    looked = _LocatedFrame.at(camera, frame)
    by_targets = [
        (count, _fastest(repeat, lambda count=count: looked.fit(count)))  # type: ignore[misc]
        for count in (TARGETS // 4, TARGETS // 2, TARGETS)
    ]
    by_length, per_length = [], 12
    for length in LENGTHS_PX:
        motion = length * 6.1 / 24.0
        other = folder_maker()(place / f"{length}", targets=per_length, amplitude_mm=(motion, motion), **common)
        its = prepare_sharp(other).cameras[0]
        alone = _LocatedFrame.at(its, read_frame(other / "captures" / "c1" / f"{its.name}.dng"))
        by_length.append((length, _fastest(repeat, lambda alone=alone: alone.fit(per_length))))  # type: ignore[misc]
    return SpeedResult(
        targets=len(camera.targets),
        unpack_s=unpack_s,
        decode_s=decode_s,
        frame_s=frame_s,
        fit_s=by_targets[-1][1],
        by_targets=by_targets,
        by_length=by_length,
        per_length=per_length,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _LocatedFrame:
    """A frame whose targets are located, ready to be fitted."""

    camera: PreparedCamera
    frame: RawFrame
    smears: Sequence[BlurredTarget]
    defocus: Defocus | None

    @classmethod
    def at(cls, camera: PreparedCamera, frame: RawFrame) -> _LocatedFrame:
        grey = frame.lazy_grey()
        found = locate_targets(grey, camera.expected)
        blur = frame_shift(frame, grey, camera.control).defocus
        return cls(camera, frame, [smear for smear in found if smear is not None], blur)

    def fit(self, count: int) -> object:
        """Cut the patches of the first `count` targets and fit them."""
        patches, starts = [], []
        for target, smear in zip(self.camera.targets, self.smears[:count], strict=False):
            reach = 1.35 * np.hypot(smear.a_px, smear.b_px) + 1.6 * np.array(target.form.half_size_px) + 10
            x, y, w, h = (round(float(v)) for v in (*smear.centre_px, *reach))
            patches.append(self.frame.patch(x - w, y - h, 2 * w + 1, 2 * h + 1))
            starts.append(InitialGuess(smear.centre_px, smear.a_px, smear.b_px))
        return measure_frame(self.camera.targets[: len(patches)], patches, initial_guesses=starts, defocus=self.defocus)


def _unpack(file: Path) -> int:
    with rawpy.imread(str(file)) as raw:
        return int(raw.raw_image_visible[0, 0])


def _fastest(repeat: int, function: Callable[[], T]) -> float:
    function()
    times = []
    for _ in range(repeat):
        # Processor time: what one core has to do, independent of other load, and with every thread counted.
        begun = time.process_time()
        function()
        times.append(time.process_time() - begun)
    return min(times)


def lines(result: SpeedResult) -> list[str]:
    """What the command prints."""
    ratio = result.frame_s / result.unpack_s
    fit_ms = result.fit_s * 1e3
    return [
        f"One 10-megapixel frame, {result.targets} targets of 31 px at up to 10 px amplitude, one core",
        f"  LibRaw unpacks it in          {result.unpack_s * 1e3:8.1f} ms",
        f"  decoded into a frame in       {result.decode_s * 1e3:8.1f} ms",
        f"  measured, decode excluded, in {result.frame_s * 1e3:8.1f} ms  (goal {GOAL_S * 1e3:.0f} ms), "
        f"{ratio:.1f} x LibRaw's unpack",
        f"  of which fits                 {fit_ms:8.1f} ms, {fit_ms / result.targets:.2f} ms a target",
        "  fits by number of targets     "
        + ", ".join(f"{count}: {seconds * 1e3:.1f} ms" for count, seconds in result.by_targets),
        f"  {result.per_length} fits by semi-amplitude    "
        + ", ".join(f"{length:g} px: {seconds * 1e3:.1f} ms" for length, seconds in result.by_length),
    ]


def document(result: SpeedResult) -> dict[str, Any]:
    """The same for a machine."""
    return {**asdict(result), "goal_s": GOAL_S, "ratio_to_unpack": result.frame_s / result.unpack_s}
