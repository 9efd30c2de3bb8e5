"""Which file belongs to which opening: by the cameras' own times and by order; a pair that is not sure is refused.

A camera's clock is set by hand and drifts, so its times are compared with the host's monotonic clock through an offset
that is learned from each capture and kept in the journal. A file that arrives late from an earlier opening, or one that
a passer-by shot with the button, then stands out by seconds. A body whose times are of no use (no date, a clock that
stands still) is paired by order: its files come in the order of the openings that it owes them for.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from pathlib import PurePath

from labdaemon.capture.devices import CardFile

TOLERANCE_S = 2.5
"""Bodies write whole seconds, some of them even ones, and take up to a fraction of a second to react."""

DRIFT = 5e-5
"""Relative drift of a camera's clock, four seconds a day: several times what users measure."""

MISFITS = 2
"""Openings in a row that a clock's time did not fit after which it is of no use."""

SD_S = 0.29
"""Standard deviation of a time in whole seconds."""

COMPANIONS = frozenset(
    {".jpg", ".jpeg", ".jpe", ".hif", ".heif", ".heic", ".avif", ".jxl", ".png", ".gif", ".bmp", ".ndf", ".xmp", ".thm"}
    | {".wav", ".mp3", ".mov", ".mp4", ".avi", ".mpg", ".mts", ".lrv", ".txt", ".csv", ".log", ".html", ".dat", ".ctg"}
)
"""Endings of what a body may write with the RAW file; such files are left on the card."""

RAW_ENDINGS = frozenset(
    {".nef", ".nrw", ".dng", ".cr2", ".cr3", ".crw", ".arw", ".srf", ".sr2", ".raf", ".rw2", ".raw", ".orf", ".pef"}
    | {".srw", ".x3f", ".mrw", ".3fr", ".fff", ".iiq", ".erf", ".mef", ".mos", ".kdc", ".dcr", ".rwl", ".gpr"}
)

NOT_RAW_FORMATS = frozenset(
    {*range(0x3001, 0x3010), 0x3801, *range(0x3803, 0x380D), *range(0x380E, 0x3811), 0xB104, 0xB105, 0xB110}
    | {*range(0xB900, 0xBB00)}
)
"""PTP's object formats of folders, notes, sounds, films and finished images, and makers' own for HEIF and films."""

LAG_TOLERANCE_S = 1.5
"""Two bodies that tell whole seconds may differ by one second more or less from one opening to the next."""
MOST_LAGS = 8  # the median of so many follows a clock that drifts

_TIME = re.compile(r"(\d{4})-?(\d\d)-?(\d\d)[T ](\d\d):?(\d\d):?(\d\d)(\.\d+)?")


def camera_seconds(captured_at: str) -> float | None:
    """A camera's time stamp (PTP's or ISO 8601, zone ignored) as seconds of its own clock; None if unreadable."""
    match = _TIME.match(captured_at.strip())
    if match is None:
        return None
    year, month, day, hour, minute, second = (int(part) for part in match.groups()[:6])
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:  # a body without a clock writes zeros, which is no day
        return None
    return moment.timestamp() + float(match[7] or 0.0)


def ending_of(file: CardFile) -> str:
    """The ending of its name in small letters, with the dot."""
    return PurePath(file.name).suffix.lower()


def is_frame(file: CardFile) -> bool:
    """Whether a file may be a RAW frame by its format and name, where its content cannot be looked at."""
    return file.format not in NOT_RAW_FORMATS and ending_of(file) not in COMPANIONS


@dataclass(frozen=True, slots=True)
class Opening:
    """One opening of the shutters, or the intention to open them.

    Attributes
    ----------
    opened_s
        On the host's monotonic clock.
    exposure_s
        A body may stamp the opening or its end.
    """

    campaign: str
    capture: str
    opened_s: float
    exposure_s: float


class FileOrigin(Enum):
    """Whose a file is, as far as its time says."""

    OWN = "of this opening"
    EARLIER = "of an earlier opening"
    FOREIGN = "of no opening"
    UNCLEAR = "of this or of an earlier opening"


@dataclass(slots=True)
class _CameraClock:
    """What is known of one camera's clock.

    Attributes
    ----------
    offset_s
        Its time stamp minus the opening, on the host's monotonic clock.
    exposure_s, measured_s
        Of the opening that the offset was taken from.
    is_doubted
        The camera was away since, and may have another time now.
    misfits
        Openings in a row that its time did not fit.
    rival_s
        The offset at the last of them.
    stamp_s
        The latest time that was seen: a clock that stands still says it again.
    """

    offset_s: float
    exposure_s: float
    measured_s: float
    is_doubted: bool = False
    misfits: int = 0
    rival_s: float | None = None
    stamp_s: float | None = None

    @property
    def is_unreliable(self) -> bool:
        """Whether it says nothing: it stands still, or jumps with each shot."""
        return self.misfits >= MISFITS

    def fits(self, stamp_s: float, opening: Opening) -> bool:
        return abs(stamp_s - opening.opened_s - self.offset_s) <= self.tolerance_s(opening)

    def tolerance_s(self, opening: Opening) -> float:
        drift_s = DRIFT * abs(opening.opened_s - self.measured_s)
        return TOLERANCE_S + abs(opening.exposure_s - self.exposure_s) + drift_s


class CameraClocks:
    """The cameras' clocks, and what their times say of a file."""

    def __init__(self) -> None:
        self._clocks: dict[str, _CameraClock] = {}

    def load(self, camera: str, offset_s: float, exposure_s: float, measured_s: float) -> None:
        """Begin with an offset that was measured before a restart; both times on the host's monotonic clock."""
        self._clocks[camera] = _CameraClock(offset_s, exposure_s, measured_s, is_doubted=True)

    def offset_s(self, camera: str) -> float | None:
        """The camera's time minus the host's monotonic one; None if unknown."""
        clock = self._clocks.get(camera)
        return None if clock is None else clock.offset_s

    def can_distinguish(self, camera: str, opening: Opening, now_s: float) -> bool:
        """Whether a file of this opening cannot be taken for one of an opening from now on."""
        clock = self._clocks.get(camera)
        return clock is not None and not clock.is_unreliable and now_s > opening.opened_s + 2.0 * TOLERANCE_S

    def owner(self, camera: str, file: CardFile, openings: Sequence[Opening]) -> Opening | None:
        """Which of these openings, oldest first, a file is of; without a useful clock the oldest."""
        clock, stamp_s = self._clocks.get(camera), camera_seconds(file.captured_at)
        if clock is None or clock.is_unreliable or stamp_s is None:
            return next(iter(openings), None)
        return next((opening for opening in openings if clock.fits(stamp_s, opening)), None)

    def judge(
        self, camera: str, file: CardFile, opening: Opening, owed: Sequence[Opening] = (), *, is_external: bool = False
    ) -> FileOrigin:
        """Whose a file is that arrived after this opening.

        Parameters
        ----------
        owed
            Earlier openings whose files have not come.
        is_external
            Others release the shutters, and may have done so again: a time that does not fit may be of the next one.
        """
        by_order = FileOrigin.UNCLEAR if owed else FileOrigin.OWN
        clock, stamp_s = self._clocks.get(camera), camera_seconds(file.captured_at)
        if clock is None or clock.is_unreliable or stamp_s is None:
            return by_order
        is_own, is_earlier = clock.fits(stamp_s, opening), any(clock.fits(stamp_s, other) for other in owed)
        if is_own:
            return FileOrigin.UNCLEAR if is_earlier else FileOrigin.OWN
        if is_earlier:
            return FileOrigin.EARLIER
        apparent_s = stamp_s - opening.opened_s
        rival_s = clock.rival_s
        is_set_anew = rival_s is not None and abs(apparent_s - rival_s) <= TOLERANCE_S
        if is_set_anew or (clock.is_doubted and not is_external):
            return by_order  # its clock was set: nothing else explains it
        if not is_external or stamp_s == clock.stamp_s:
            clock.misfits += 1
        clock.rival_s, clock.stamp_s = apparent_s, stamp_s
        return FileOrigin.FOREIGN

    def deviation_s(self, camera: str, file: CardFile, opening: Opening) -> float:
        """How far a file's time is from an opening, seconds; 0 where that is unknown."""
        clock, stamp_s = self._clocks.get(camera), camera_seconds(file.captured_at)
        return 0.0 if clock is None or stamp_s is None else stamp_s - opening.opened_s - clock.offset_s

    def update(self, files: Mapping[str, CardFile], opening: Opening) -> None:
        """These files are of this opening: learn the clocks from them."""
        for camera, file in files.items():
            stamp_s = camera_seconds(file.captured_at)
            if stamp_s is None:
                continue  # a body without a clock is paired by order alone
            apparent_s = stamp_s - opening.opened_s
            before = self._clocks.get(camera)
            clock = self._clocks[camera] = _CameraClock(
                apparent_s, opening.exposure_s, opening.opened_s, stamp_s=stamp_s
            )
            if before is not None and not before.fits(stamp_s, opening):
                is_set_anew = before.rival_s is not None and abs(apparent_s - before.rival_s) <= TOLERANCE_S
                clock.misfits = 0 if is_set_anew else before.misfits + 1
                clock.rival_s = apparent_s

    def invalidate(self, camera: str) -> None:
        """The camera was away and may have another time now."""
        clock = self._clocks.get(camera)
        if clock is not None:
            clock.is_doubted = True


def _near(lags: tuple[float, ...], others: tuple[float, ...]) -> bool:
    return all(abs(one - other) <= LAG_TOLERANCE_S for one, other in zip(lags, others, strict=True))


class ReleasePairing:
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
        self._alone: list[tuple[str, CardFile]] = []
        self._lags: list[tuple[float, ...]] = []
        """How far the bodies' clocks are apart, seconds: as in the last set that was accepted, then in refused ones."""
        self.first_s: float = 0.0
        """Monotonic time at which the first file of the last whole set arrived."""

    def add(self, camera: str, file: CardFile, at_s: float) -> dict[str, CardFile] | None:
        """Take a file that arrived at this monotonic time; the whole set, once every camera's is there."""
        self._waiting[camera].append((at_s, file))
        while all(self._waiting.values()):
            first = {camera: queue[0] for camera, queue in self._waiting.items()}
            if self._is_one_opening([file for _, file in first.values()]):
                self.first_s = min(at_s for at_s, _ in first.values())
                return {camera: queue.pop(0)[1] for camera, queue in self._waiting.items()}
            oldest = min(first, key=lambda camera: first[camera][0])
            self._alone.append((oldest, self._waiting[oldest].pop(0)[1]))
        return None

    def _is_one_opening(self, files: Sequence[CardFile]) -> bool:
        """Whether the bodies' own times are as far apart as they were before.

        A release that one body missed would otherwise pair its next frame with the other's last one. A difference that
        comes twice is a clock that was set, and counts from then on.
        """
        stamps = [camera_seconds(file.captured_at) for file in files]
        if any(stamp is None for stamp in stamps):
            return True  # a body without a clock is paired by order alone
        lags = tuple((stamp or 0.0) - (stamps[0] or 0.0) for stamp in stamps)
        known = [other for other in self._lags if _near(lags, other)]
        if self._lags and not known:
            self._lags = [*self._lags, lags][-MOST_LAGS:]
            return False
        self._lags = [lags]
        return True

    def late(self, now_s: float) -> list[tuple[str, CardFile]]:
        """Files whose window has closed without the others'; they will make no capture any more."""
        late, self._alone = self._alone, []
        for camera, queue in self._waiting.items():
            while queue and now_s - queue[0][0] > self._window_s:
                late.append((camera, queue.pop(0)[1]))
        return late
