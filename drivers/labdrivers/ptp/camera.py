"""A camera on USB: the driver of the group ``labdaemon.cameras`` for bodies that speak PTP.

Shots are fired by cable, so the body is never taken over (that would lock its own controls). Nothing is deleted
without a request. After a fault, `connect` again: files that came meanwhile are still news.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field

from labdaemon.capture.devices import CameraInfo, CameraStatus, CardFile
from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError
from labdrivers.ptp.codes import Op, Prop, Response
from labdrivers.ptp.container import BadContainer
from labdrivers.ptp.events import EventListener
from labdrivers.ptp.exposure import describe, exposure_times, set_exposure, set_nearest
from labdrivers.ptp.find import load_backend, open_camera
from labdrivers.ptp.objects import card_file, fetch, free_bytes, read_part
from labdrivers.ptp.power_cycle import PowerCycle
from labdrivers.ptp.session import PtpRefused, PtpSession
from labdrivers.ptp.transport import UsbPipe
from labdrivers.ptp.watch import FileWatch
from labdrivers.settings import DriverSettings, read_settings

OTHERS_KEYS = frozenset(
    {"driver", "exposure_s", "f_number", "iso", "image_size", "focal_px", "principal_point_px", "distortion"}
)
"""Keys of a camera's section that are not for its driver."""
WAKE_POLL_S = 0.25  # a body that slept takes a second or two to answer


class PtpSettings(DriverSettings):
    """``[cameras.NAME]`` of the rig file for ``driver = "ptp"``."""

    serial: str = Field(min_length=1)
    backend: str = "libusb"
    backend_url: str | None = None
    timeout_s: float = Field(default=10.0, gt=0, le=120)
    power_cycle: tuple[str, ...] = ()
    """Command that takes the camera's power away and gives it back, run when it does not answer `connect`."""
    wakes_after_s: float = Field(default=10.0, ge=0, le=120)
    """How long the body may take after that until it is on the bus."""


class PtpCamera:
    """One body, known by its serial number.

    Parameters
    ----------
    name
        Camera's name in the rig file.
    settings
        Its section.
    """

    SETTINGS: ClassVar[frozenset[str]] = frozenset(PtpSettings.model_fields)

    def __init__(self, name: str, settings: Mapping[str, Any]) -> None:
        self.name = name
        self._settings = read_settings(PtpSettings, settings, key=f"cameras.{name}", ignore=OTHERS_KEYS)
        self._pipe: UsbPipe | None = None
        self._session: PtpSession | None = None
        self._events: EventListener | None = None
        self._watch: FileWatch | None = None
        self._known: set[CardFile] | None = None
        self._lock = threading.RLock()
        self._power_cycle = PowerCycle(name, self._settings.power_cycle)

    def connect(self) -> CameraInfo:
        """Find the body by its serial number and open a session; an earlier one is closed first.

        Files that appeared while the camera was away are news for `wait_file`, those there at the first `connect`
        are not (`files` lists them all).

        Raises
        ------
        TransportError
            The camera is not on the bus, or does not answer.
        DeviceRefused
            It does not, and the `power_cycle` command failed.
        """
        self.close()
        settings = self._settings
        backend = load_backend(settings.backend, settings.backend_url, key=f"cameras.{self.name}.backend")
        with self._lock, self._parsing():
            self._pipe, self._session = self._open(backend)
            try:
                self._events = EventListener(self._pipe)
                self._events.start()
                self._watch = FileWatch(self._session, self._events, self._known)
                self._known = self._watch.known
                info = self._session.info
            except (DeviceError, BadContainer):
                self.close()
                raise
        return CameraInfo(info.manufacturer, info.model, info.serial)

    def _open(self, backend: Any) -> tuple[UsbPipe, PtpSession]:
        """Find and open the body; one that stays dead gets its power cycled, if there is a hook and not too often."""
        settings = self._settings
        try:
            return open_camera(self.name, settings.serial, backend, timeout_s=settings.timeout_s)
        except (TransportError, ProtocolError):
            if not self._power_cycle.due():
                raise
        self._power_cycle.run()
        deadline = time.monotonic() + settings.wakes_after_s
        while True:
            try:
                return open_camera(self.name, settings.serial, backend, timeout_s=settings.timeout_s)
            except (TransportError, ProtocolError):
                if time.monotonic() >= deadline:
                    raise
            time.sleep(WAKE_POLL_S)

    def close(self) -> None:
        """End the session and release the interface; harmless in every state."""
        with self._lock:
            events, self._events = self._events, None
            session, self._session = self._session, None
            pipe, self._pipe = self._pipe, None
            self._watch = None
        if events is not None:
            events.close()
        if session is not None:
            session.close()
        if pipe is not None:
            pipe.close()

    def configure(
        self, *, exposure_s: float | None = None, f_number: float | None = None, iso: int | None = None
    ) -> float:
        """Set what is given and read it back; return the exposure time that the body now has, seconds.

        Raises
        ------
        DeviceRefused
            The body's dial decides, or it has no such value; the message says which dial or values.
        """
        session = self._connected()
        with self._parsing():
            if f_number is not None:
                set_nearest(session, Prop.F_NUMBER, 100 * f_number, "f-number × 100")
            if iso is not None:
                set_nearest(session, Prop.ISO, iso, "ISO")
            if exposure_s is not None:
                return set_exposure(session, exposure_s)
            current = exposure_times(session).current_s
        if current is None:
            raise DeviceRefused("is on bulb; turn its shutter to a time", device=self.name)
        return current

    def exposure_steps_s(self) -> tuple[float, ...]:
        """Exposure times offered now, ascending, as the body names them; a single one when its dial decides."""
        with self._parsing():
            return tuple(sorted(exposure_times(self._connected()).steps_s.values()))

    def status(self) -> CameraStatus:
        """Battery and the free space of all cards."""
        session = self._connected()
        with self._parsing():
            battery = describe(session, Prop.BATTERY)
            return CameraStatus(None if battery is None else int(battery.current), free_bytes(session))

    def wait_file(self, timeout_s: float) -> CardFile | None:
        """Next new file that is written to its end, whatever reported it; None when none came in time.

        Raises
        ------
        DeviceRefused
            The body says that its card is full.
        """
        watch = self._watching()
        with self._parsing():
            return watch.next(timeout_s)

    def files(self) -> list[CardFile]:
        """All files on the camera, folders left out, oldest first."""
        watch = self._watching()
        with self._parsing():
            return watch.files()

    def download(self, file: CardFile, to: Path) -> None:
        """Write the file to `to`, going on from its present length; what was fetched stays when it fails.

        Raises
        ------
        DeviceRefused
            The camera has no such file any more.
        TransportError, ProtocolError
            The transfer broke; call again after `connect` and it is resumed.
        """
        with self._parsing():
            fetch(self._connected(), file, to)

    def describe(self, file: CardFile) -> CardFile | None:
        """The file that its handle refers to now; None if it is gone."""
        with self._parsing():
            now = card_file(self._connected(), file.handle)
        watch = self._watch
        if now != file and watch is not None:
            watch.ask_again(file.handle)
        return now

    def read(self, file: CardFile, offset: int, size: int) -> bytes:
        """Part of a file, fewer bytes at its end.

        Raises
        ------
        DeviceRefused
            The camera has no such file any more, or cannot send parts.
        """
        return read_part(self._connected(), file, offset, size)

    def delete(self, file: CardFile) -> None:
        """Delete the camera's copy; one that is gone already is no error.

        Raises
        ------
        DeviceRefused
            The handle refers to another file now, or to more bytes than were fetched; nothing is deleted.
        """
        now = self.describe(file)
        if now is not None and now != file:
            raise DeviceRefused(
                f"has {now.name} ({now.size_bytes} bytes) where {file.name} ({file.size_bytes} bytes) was; it is kept",
                device=self.name,
            )
        session = self._connected()
        try:
            if now is not None:
                session.call(Op.DELETE_OBJECT, file.handle, 0)
        except PtpRefused as exc:
            if exc.code != Response.BAD_HANDLE:
                raise
        watch = self._watch
        if watch is not None:
            watch.forget(file.handle)

    def _connected(self) -> PtpSession:
        session = self._session  # read once: another thread may close meanwhile
        if session is None:
            raise TransportError("not connected; connect first", device=self.name)
        return session

    def _watching(self) -> FileWatch:
        watch = self._watch
        if watch is None:
            raise TransportError("not connected; connect first", device=self.name)
        return watch

    @contextmanager
    def _parsing(self) -> Iterator[None]:
        try:
            yield
        except BadContainer as exc:
            raise ProtocolError(f"sent a dataset that makes no sense ({exc})", device=self.name) from exc
