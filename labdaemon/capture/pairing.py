"""Which file belongs to which opening: by the cameras' own times and by order, and a mispair is refused.

A camera's clock is set by hand and drifts, so its times are compared with the host's monotonic clock through an offset
that is learned from the first capture and followed from then on. A file that arrived late from an earlier opening, or
one that a passer-by shot with the button, then stands out by seconds.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime

from labdaemon.capture.devices import CardFile
from labdaemon.errors import DeviceError

TOLERANCE_S = 2.5
"""Bodies tell their time in whole seconds, and stamp at the opening or at its end."""

PICTURE_SIDECARS = (".jpg", ".jpeg", ".wav", ".xmp")
"""What a body may write beside the RAW file; left on the card."""

_TIME = re.compile(r"(\d{4})-?(\d\d)-?(\d\d)[T ](\d\d):?(\d\d):?(\d\d)(\.\d+)?")


def camera_seconds(captured_at: str) -> float | None:
    """A camera's time stamp (PTP's or ISO 8601, zone ignored) as seconds of its own clock; None if unreadable."""
    match = _TIME.match(captured_at.strip())
    if match is None:
        return None
    year, month, day, hour, minute, second = (int(part) for part in match.groups()[:6])
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return moment.timestamp() + float(match[7] or 0.0)


def is_frame(file: CardFile) -> bool:
    """Whether a file is a RAW frame rather than its JPEG or a note beside it."""
    return not file.name.lower().endswith(PICTURE_SIDECARS)


class CameraClocks:
    """What is known of each camera's clock: its offset from the host's monotonic one, seconds."""

    def __init__(self) -> None:
        self._offset_s: dict[str, float] = {}

    def check(self, files: Mapping[str, CardFile], opened_s: float, exposure_s: float) -> None:
        """Accept the files of one opening, and follow the clocks.

        Parameters
        ----------
        files
            One file a camera.
        opened_s
            The opening on the host's monotonic clock.
        exposure_s
            A body may stamp the opening or its end.

        Raises
        ------
        DeviceError
            A file's time does not fit this opening.
        """
        seen: dict[str, float] = {}
        for camera, file in files.items():
            stamp = camera_seconds(file.captured_at)
            if stamp is None:
                continue  # a body without a clock is paired by order alone
            seen[camera] = stamp - opened_s
            known = self._offset_s.get(camera)
            if known is None:
                continue
            off_s = seen[camera] - known
            if not -TOLERANCE_S <= off_s <= TOLERANCE_S + exposure_s:
                raise DeviceError(
                    f"{file.name} was taken {off_s:+.1f} s away from this opening and belongs to another one; "
                    "the capture is repeated",
                    device=camera,
                )
        self._offset_s.update(seen)

    def forget(self, camera: str) -> None:
        """The camera was away and may have another time now."""
        self._offset_s.pop(camera, None)


class Arrivals:
    """Sorts files that outside releases made into captures: one from every camera within a window.

    Parameters
    ----------
    cameras
        Names of all cameras.
    window_s
        Longest time between the first and the last file of a capture.
    """

    def __init__(self, cameras: tuple[str, ...], window_s: float) -> None:
        self._cameras, self._window_s = cameras, window_s
        self._waiting: dict[str, list[tuple[float, CardFile]]] = {camera: [] for camera in cameras}

    def add(self, camera: str, file: CardFile, at_s: float) -> dict[str, CardFile] | None:
        """Take a file that arrived at this monotonic time; the whole set, once every camera's is there."""
        self._waiting[camera].append((at_s, file))
        if not all(self._waiting.values()):
            return None
        return {camera: queue.pop(0)[1] for camera, queue in self._waiting.items()}

    def late(self, now_s: float) -> list[tuple[str, CardFile]]:
        """Files whose window has closed without the others'; they will make no capture any more."""
        late: list[tuple[str, CardFile]] = []
        for camera, queue in self._waiting.items():
            while queue and now_s - queue[0][0] > self._window_s:
                late.append((camera, queue.pop(0)[1]))
        return late
