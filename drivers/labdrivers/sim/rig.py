"""The simulated rig: a table, a structure on it, and cameras before it, as pure physics with time passed in.

No wires here: the wire simulators (`*_device`) share one `RigModel`, so that the shaker's commands move what the
cameras see. All times are seconds of one clock that the caller owns; commands come in ascending order, questions
about any past time are answered from the history of commands.

    rig = RigModel(RigSpec())
    rig.drive(t, frequency_hz=5.0, level_v=0.54, running=True)      # generator's output from t on
    rig.enable(t, True)                                             # amplifier's enable line
    rig.table_mm(times); rig.response_mm(times, point_mm=...)       # gauges
    rig.excitation_phase(t); rig.moving(t); rig.tripped             # sync output, safety
    rig.set_lamp(t, 0.0)                                            # the lamp's pin from t on
    job = rig.exposure_job("left", opened_s, exposure_s)            # small and picklable, when the shutter has closed
    render_job(job)                                                 # -> bytes of a DNG, seconds of work, any process
    rig.truth(opened_s, exposure_s)                                 # JSON-able, for tests and demo only
    rig.records                                                     # the same for every job made so far
"""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from labdrivers.sim.dng import write_dng
from labdrivers.sim.lamp import LampHistory, LampPlay
from labdrivers.sim.lens import FloatArray
from labdrivers.sim.optics import Optics
from labdrivers.sim.render import RenderedFrame, render_frame
from labdrivers.sim.spec import RigSpec
from labdrivers.sim.structure import HEIGHT_MM
from labdrivers.sim.table import ExcitationHistory, rest_before

TOP_MM = (150.0, -100.0, HEIGHT_MM)
"""Where the response gauge looks: the top of the right front column."""

KEEP_INTERVALS = 4000
"""Commands remembered; at 20 a second while ramping that is many steps back."""


@dataclass(frozen=True, slots=True)
class ExposureJob:
    """Everything needed to make one frame, in any process.

    Attributes
    ----------
    history
        Commands that matter during the exposure.
    opened_s, exposure_s
        Window on the rig's clock.
    shot
        Number of the exposure: seeds its noise.
    captured_at
        ``YYYY:MM:DD HH:MM:SS`` for the file, or empty.
    lamp
        What the lamp did; None where it was at full brightness throughout.
    """

    spec: RigSpec
    camera: str
    history: ExcitationHistory
    opened_s: float
    exposure_s: float
    iso: int
    f_number: float
    shot: int
    captured_at: str = ""
    lamp: LampPlay | None = None


class RigModel:
    """Table, structure and cameras. Thread-safe: all state is one immutable history behind a lock."""

    def __init__(self, spec: RigSpec | None = None) -> None:
        self.spec = spec or RigSpec()
        self._lock = threading.Lock()
        self._history = rest_before(self.spec.modes)
        self._command = (1.0, 0.0, False)
        self._enabled = True
        self._shots = 0
        self._lamp = LampHistory()
        self._tripped: str | None = None
        self._records: list[dict[str, Any]] = []

    # -- what moves the table ------------------------------------------------------------------------------------

    def drive(
        self, t: float, *, frequency_hz: float, level_v: float, running: bool, phase_rad: float | None = None
    ) -> None:
        """The generator's output from `t` on: a sine of `level_v` volts (zero to peak), or nothing.

        The phase is continuous unless `phase_rad`, the phase at `t`, is given. A sine beyond the table's
        limits trips the amplifier; it stays tripped until a command with ``running=False``.
        """
        with self._lock:
            self._command = (float(frequency_hz), float(level_v), bool(running))
            if not running:
                self._tripped = None
            self._apply(t, phase_rad)

    def enable(self, t: float, up: bool) -> None:
        """The amplifier's enable line. Down: the table comes to rest whatever the generator says."""
        with self._lock:
            if up != self._enabled:
                self._enabled = up
                self._apply(t, None)

    def _apply(self, t: float, phase_rad: float | None) -> None:
        frequency_hz, level_v, running = self._command
        amplitude_mm = abs(self.spec.table.response(frequency_hz)) * level_v
        if running and self._enabled and self._tripped is None:
            self._tripped = self.spec.table.refuses(frequency_hz, amplitude_mm)
        live = running and self._enabled and self._tripped is None
        last = self._history.at(t)
        if last is None and not live:
            return
        if last is not None and self._history.intervals[-1].start_s > t:
            t = self._history.intervals[-1].start_s  # two threads' commands crossed: the later call wins
            last = self._history.intervals[-1]
        phase = phase_rad if phase_rad is not None else float(last.phase(t)) if last is not None else 0.0
        history = self._history.then(
            t, self.spec.table, frequency_hz=frequency_hz, level_v=level_v if live else 0.0, phase_rad=phase
        )
        self._history = ExcitationHistory(history.modes, history.intervals[-KEEP_INTERVALS:])

    def set_lamp(self, t: float, level: float) -> None:
        """The lamp's pin from `t` on, 0 to 1; without effect on a lamp that is not wired to it."""
        if self.spec.lamp.is_wired:
            with self._lock:
                self._lamp.add(t, level)

    # -- what instruments see ------------------------------------------------------------------------------------

    @property
    def tripped(self) -> str | None:
        """Why the amplifier switched itself off, or None."""
        return self._tripped

    @property
    def enabled(self) -> bool:
        """State of the enable line."""
        return self._enabled

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(self.spec.cameras)

    def image_size(self, camera: str) -> tuple[int, int]:
        """(width, height) of a camera's frames."""
        return self.spec.cameras[camera].image_size

    def table_mm(self, t: FloatArray) -> FloatArray:
        """Table displacement (n,) along X at ascending times."""
        return self._history.evaluate(np.atleast_1d(t))[0]

    def displacement_mm(self, points_mm: FloatArray, t: FloatArray) -> FloatArray:
        """Displacement (points, n, 3) of points (points, 3) of table and structure at ascending times."""
        return displacements(self._history, points_mm, np.atleast_1d(t))

    def response_mm(self, t: FloatArray, point_mm: tuple[float, float, float] = TOP_MM) -> FloatArray:
        """Displacement (n,) along X of one point of the structure, as a laser gauge next to the rig reads it."""
        return self.displacement_mm(np.array([point_mm]), t)[0, :, 0]

    def acceleration_m_s2(self, t: FloatArray, point_mm: tuple[float, float, float] = TOP_MM) -> FloatArray:
        """Acceleration (n,) along X of one point, as an accelerometer there reads it."""
        step = 2e-4
        times = np.atleast_1d(np.asarray(t, float))
        stencil = np.sort(np.concatenate([times - step, times, times + step]))
        x = self.response_mm(stencil, point_mm)
        before, here, after = (x[np.searchsorted(stencil, times + d)] for d in (-step, 0.0, step))
        return np.asarray((before - 2.0 * here + after) / step**2 * 1e-3)

    def excitation_phase(self, t: float) -> float | None:
        """The generator's phase ωt at `t`, None while it has never run."""
        interval = self._history.at(t)
        return None if interval is None else float(interval.phase(t))

    def frequency_hz(self, t: float) -> float | None:
        """What the generator was set to at `t`, None while its output was off."""
        interval = self._history.at(t)
        return None if interval is None or interval.amplitude_mm == 0.0 else interval.frequency_hz

    def moving(self, t: float, limit_mm: float = 0.01) -> bool:
        """Whether the table is moving more than `limit_mm` about `t` (looking one cycle ahead as things stand)."""
        history = self._history
        interval = history.at(t)
        if interval is None:
            return False
        times = t + np.linspace(0.0, 1.0 / max(interval.frequency_hz, 0.5), 32)
        table = history.window(t, t).evaluate(times)[0]
        return bool(np.ptp(table) > 2.0 * limit_mm)

    # -- what cameras see ----------------------------------------------------------------------------------------

    def exposure_job(
        self,
        camera: str,
        opened_s: float,
        exposure_s: float,
        *,
        iso: int | None = None,
        f_number: float | None = None,
        captured_at: str = "",
    ) -> ExposureJob:
        """What `render_job` needs for one exposure. Ask when the shutter has closed: later commands do not count."""
        with self._lock:
            self._shots += 1
            shot, history = self._shots, self._history
            lamp = self._lamp.play(opened_s, opened_s + exposure_s, self.spec.lamp.rise_s, self.spec.lamp.ambient)
        job = ExposureJob(
            self.spec,
            camera,
            history.window(opened_s, opened_s + exposure_s),
            opened_s,
            exposure_s,
            iso or self.spec.iso,
            f_number or self.spec.f_number,
            shot,
            captured_at,
            lamp,
        )
        record = {"camera": camera, "shot": shot, **self.truth(opened_s, exposure_s)}
        with self._lock:
            self._records.append(record)
        return job

    def truth(self, opened_s: float, exposure_s: float) -> dict[str, Any]:
        """What every target really did in a window: for tests and `demo`, never for the measurement.

        Returns
        -------
        dict
            ``opened_s``, ``exposure_s``, ``frequency_hz`` and ``phase_rad`` (excitation at the opening; None at
            rest), and ``targets``: name -> ``x_mm y_mm z_mm ax_mm ay_mm az_mm bx_mm by_mm bz_mm``, the semi-amplitudes
            fitted by least squares to the motion in the window.
        """
        history = self._history
        frequency_hz = self.frequency_hz(opened_s)
        phase_rad = self.excitation_phase(opened_s) if frequency_hz is not None else None
        times = opened_s + (np.arange(2000) + 0.5) / 2000 * exposure_s
        points = np.array([target.centre_mm for target in self.spec.targets])
        moved = displacements(history, points, times)
        columns = [np.ones_like(times)]
        if frequency_hz is not None and phase_rad is not None:
            angle = phase_rad + 2.0 * np.pi * frequency_hz * (times - opened_s)
            columns += [np.sin(angle), np.cos(angle)]
            # Over part cycles harmonics would leak into the fundamental.
            for order, _, _ in self.spec.table.harmonics:
                columns += [np.sin(order * angle), np.cos(order * angle)]
        solution = np.linalg.lstsq(np.stack(columns, axis=1), moved.transpose(1, 0, 2).reshape(times.size, -1))[0]
        fitted = np.zeros((3, points.shape[0], 3))
        fitted[: len(columns)] = solution.reshape(len(columns), points.shape[0], 3)[:3]
        keys = ("x_mm", "y_mm", "z_mm", "ax_mm", "ay_mm", "az_mm", "bx_mm", "by_mm", "bz_mm")
        rows = np.concatenate([points + moved.mean(axis=1), fitted[1], fitted[2]], axis=1)
        return {
            "opened_s": opened_s,
            "exposure_s": exposure_s,
            "frequency_hz": frequency_hz,
            "phase_rad": phase_rad,
            "targets": {
                target.name: dict(zip(keys, map(float, row), strict=True))
                for target, row in zip(self.spec.targets, rows, strict=True)
            },
        }

    @property
    def records(self) -> list[dict[str, Any]]:
        """`truth` of every exposure so far, with its ``camera`` and ``shot``."""
        with self._lock:
            return list(self._records)


def displacements(history: ExcitationHistory, points_mm: FloatArray, t: FloatArray) -> FloatArray:
    """Displacement (points, n, 3) of points (points, 3) that ride on the table, at ascending times, mm."""
    table, q = history.evaluate(t)
    points = np.atleast_2d(points_mm)
    moved = np.zeros((points.shape[0], table.size, 3))
    moved[:, :, 0] = table
    for mode, coordinate in zip(history.modes, q, strict=True):
        moved += mode.shape(points)[:, None, :] * coordinate[None, :, None]
    return moved


def render_exposure(job: ExposureJob) -> RenderedFrame:
    """The frame of one exposure with its truth in the image (for tests; cameras deliver `render_job`'s bytes)."""
    spec = job.spec
    seen = spec.cameras[job.camera]
    history = job.history
    frequency = history.at(job.opened_s)

    def motion_of(point: FloatArray) -> Callable[[FloatArray], FloatArray]:
        return lambda t: displacements(history, point[None, :], t)[0]

    still = not history.intervals
    corners = np.array([panel.corners_mm for panel in spec.scene.panels], float).reshape(-1, 3)
    # twice the time, the sensitivity or the aperture's area gives twice the light
    light = (job.exposure_s / spec.at_s) * (job.iso / spec.iso) * (spec.f_number / job.f_number) ** 2
    return render_frame(
        spec.scene,
        seen.camera(),
        motions=None if still else {t.name: motion_of(np.asarray(t.centre_mm, float)) for t in spec.targets},
        panel_motion=None if still else lambda t: displacements(history, corners, t),
        brightness=None if job.lamp is None else job.lamp.relative,
        opened_s=job.opened_s,
        exposure_s=job.exposure_s,
        frequency_hz=frequency.frequency_hz if frequency is not None and frequency.amplitude_mm > 0 else None,
        phase_rad=float(frequency.phase(job.opened_s)) if frequency is not None else 0.0,
        white_dn=spec.white_dn * light,
        optics=Optics(f_number=job.f_number),
        sensor=replace(spec.sensor, serial=int(seen.serial)),
        seed=spec.seed * 100_003 + job.shot,
    )


def render_job(job: ExposureJob) -> bytes:
    """The DNG file of one exposure: what the camera puts on its card."""
    spec = job.spec
    file = io.BytesIO()
    write_dng(
        file,
        render_exposure(job).mosaic,
        spec.sensor.pattern,
        spec.sensor.black,
        spec.sensor.white,
        serial=spec.cameras[job.camera].serial,
        captured_at=job.captured_at or "2026:01:01 00:00:00",
        exposure_s=job.exposure_s,
        f_number=job.f_number,
        iso=job.iso,
    )
    return file.getvalue()
