"""Envelopes as objects: the motion of all targets in a capture, in millimetres.

The same objects come from a data-set folder (`labdaemon.process`), from a result file (`read_envelopes`) and from the
events of a daemon (`labdaemon.Client`). A point moves as ``d(t) = a sin(ωt) + b cos(ωt)`` about its mean. Without phase
a is the major semi-axis of the orbit and b the minor one. Object space is right-handed, Z up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labdaemon.correlations import MOTION, POSITION, correlations_in, covariance_of
from labdaemon.errors import UsageError
from labdaemon.flags import Flag
from labdaemon.named_sequence import NamedSequence
from labdaemon.orbit_size import semi_major_axis

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

FloatArray = NDArray[np.float64]

_VECTORS = ("", "a", "b")
_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True, eq=False)
class TargetEnvelope:
    """The motion of one target in one capture.

    Attributes
    ----------
    target
        Name of the target.
    mean_mm, a_mm, b_mm
        (3,) each; NaN where not measured.
    sd_mean_mm, sd_a_mm, sd_b_mm
        (3,) standard deviations; NaN where not known (the normal component with one camera).
    residual_ratio
        Residual of the second-best solution divided by that of the best one; None where nothing was to be decided.
    flags
        Statements about this target, empty when all is well.
    correlations
        Of the position and of the motion, by the name of their column in `envelope.csv`; empty where not known.
    """

    target: str
    mean_mm: FloatArray
    a_mm: FloatArray
    b_mm: FloatArray
    sd_mean_mm: FloatArray
    sd_a_mm: FloatArray
    sd_b_mm: FloatArray
    residual_ratio: float | None = None
    flags: frozenset[Flag] = field(default_factory=frozenset)
    correlations: Mapping[str, float] = field(default_factory=dict)

    @property
    def covariance_mean_mm2(self) -> FloatArray:
        """(3, 3) covariance of `mean_mm`, mm²; NaN where there is no sd, diagonal where correlations are not known."""
        return self._covariance()[POSITION, POSITION]

    @property
    def covariance_motion_mm2(self) -> FloatArray:
        """(6, 6) covariance of `a_mm`, then `b_mm`, mm²; NaN where there is no sd, diagonal likewise."""
        return self._covariance()[MOTION, MOTION]

    def _covariance(self) -> FloatArray:
        return covariance_of(np.concatenate([self.sd_mean_mm, self.sd_a_mm, self.sd_b_mm]), self.correlations)

    @property
    def amplitude_mm(self) -> float:
        """Major semi-axis of the orbit, zero to peak; NaN where not measured."""
        vectors = np.column_stack((self.a_mm, self.b_mm))
        if not np.isfinite(vectors).all():
            return math.nan
        return semi_major_axis(self.a_mm.tolist(), self.b_mm.tolist())

    @property
    def sd_mm(self) -> float:
        """Standard deviation of `amplitude_mm`, to first order, with the correlations that are known."""
        vectors = np.column_stack((self.a_mm, self.b_mm))
        if not np.isfinite(vectors).all():
            return math.nan
        left, _, right = np.linalg.svd(vectors)
        slope = np.outer(right[0], left[:, 0]).ravel()  # by a, then by b
        variance = float(slope @ np.nan_to_num(self.covariance_motion_mm2) @ slope)
        return math.sqrt(max(variance, 0.0))

    def __repr__(self) -> str:
        flags = f", flags {';'.join(sorted(self.flags))}" if self.flags else ""
        return f"<TargetEnvelope {self.target}: {self.amplitude_mm:.4f} ± {self.sd_mm:.4f} mm{flags}>"

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> TargetEnvelope:
        """Build it from a row of `envelope.csv` or an element of ``envelope.data.targets``.

        Columns that this version does not know are ignored, so that a newer daemon can be read.

        Raises
        ------
        KeyError
            The row has no ``target``.
        """

        def vector(prefix: str, name: str) -> FloatArray:
            values = (row.get(f"{prefix}{name}{axis}_mm") for axis in _AXES)
            return np.array([math.nan if value is None else float(value) for value in values])

        known = {flag.value: flag for flag in Flag}
        ratio = row.get("residual_ratio")
        mean, a, b = (vector("", name) for name in _VECTORS)
        sd_mean, sd_a, sd_b = (vector("sd_", name) for name in _VECTORS)
        return cls(
            str(row["target"]),
            mean,
            a,
            b,
            sd_mean,
            sd_a,
            sd_b,
            residual_ratio=None if ratio is None else float(ratio),
            flags=frozenset(known[flag] for flag in row.get("flags") or () if flag in known),
            correlations=correlations_in(row),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Envelope(NamedSequence[TargetEnvelope]):
    """The motion of all targets in one capture (or one group of captures); a sequence of `TargetEnvelope`.

    Attributes
    ----------
    capture
        Name of the capture or group.
    targets
        One element per target; a target that could not be measured has NaN and a flag.
    frequency_hz, excitation_amplitude_mm, exposure_s
        What is known of the excitation and the exposure; None where it is not.
    opened_at
        UTC of the opening as RFC 3339 text; None where it is not known.
    """

    capture: str
    targets: tuple[TargetEnvelope, ...]
    frequency_hz: float | None = None
    excitation_amplitude_mm: float | None = None
    exposure_s: float | None = None
    opened_at: str | None = None

    def _elements(self) -> tuple[TargetEnvelope, ...]:
        return self.targets

    def _name_of(self, element: TargetEnvelope) -> str:
        return element.target

    def _missing(self, name: str) -> str:
        return f"no target {name!r} in capture {self.capture}"

    def __repr__(self) -> str:
        clean = [one for one in self.targets if not one.flags and math.isfinite(one.amplitude_mm)]
        largest = max((one.amplitude_mm for one in clean), default=math.nan)
        return (
            f"<Envelope {self.capture}: {len(self.targets)} targets, {len(clean)} without flags, "
            f"largest amplitude {largest:.4f} mm>"
        )

    def to_array(self) -> NDArray[np.void]:
        """Structured array with one record per target: the columns of `envelope.csv` and ``amplitude_mm``, float64.

        Flags are text, separated by ``;``.
        """
        numbers = [f"{sd}{name}{axis}_mm" for sd in ("", "sd_") for name in _VECTORS for axis in _AXES]
        columns = [(name, "f8") for name in (*numbers, "amplitude_mm", "sd_mm")]
        records = []
        for one in self.targets:
            sds = (one.sd_mean_mm, one.sd_a_mm, one.sd_b_mm)
            values = np.concatenate([one.mean_mm, one.a_mm, one.b_mm, *sds])
            flags = ";".join(flag.value for flag in Flag if flag in one.flags)
            records.append((one.target, *values, one.amplitude_mm, one.sd_mm, flags))
        return np.array(records, dtype=[("target", "U64"), *columns, ("flags", "U160")])

    def to_dataframe(self) -> pd.DataFrame:
        """The same as a pandas table, with the name of the capture.

        Raises
        ------
        UsageError
            pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise UsageError("pandas is not installed; run: pip install pandas") from None
        table = pd.DataFrame(self.to_array())
        table.insert(0, "capture", self.capture)
        return table

    def to_xarray(self) -> xr.Dataset:
        """The same as an xarray dataset over ``target``, with what is known of the capture as attributes.

        Raises
        ------
        UsageError
            xarray is not installed.
        """
        try:
            import xarray as xr
        except ImportError:
            raise UsageError("xarray is not installed; run: pip install 'labdaemon[analysis]'") from None
        records = self.to_array()
        names = [name for name in records.dtype.names or () if name != "target"]
        about = {
            "capture": self.capture,
            "frequency_hz": self.frequency_hz,
            "excitation_amplitude_mm": self.excitation_amplitude_mm,
            "exposure_s": self.exposure_s,
        }
        return xr.Dataset(
            {name: ("target", records[name]) for name in names},
            coords={"target": records["target"]},
            attrs={name: value for name, value in about.items() if value is not None},
        )

    @classmethod
    def from_event(cls, data: Mapping[str, Any]) -> Envelope:
        """Build it from the ``data`` of an ``envelope`` event; members that this version does not know are ignored."""
        return cls(
            str(data["capture"]),
            tuple(TargetEnvelope.from_row(row) for row in data["targets"]),
            **{name: data.get(name) for name in ("frequency_hz", "excitation_amplitude_mm", "exposure_s", "opened_at")},
        )
