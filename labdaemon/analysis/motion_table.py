"""What `labdaemon.measure` returns: one measurement per target, as a sequence and as a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labdaemon.blur import Measurement
from labdaemon.errors import UsageError
from labdaemon.named_sequence import NamedSequence
from labdaemon.processing import MEASUREMENT_COLUMNS, Row, csv_text, measurement_row

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False)
class MotionTable(NamedSequence[Measurement]):
    """The motion of all targets in one image (or one group of images), in pixels.

    Attributes
    ----------
    name
        Name of the blurred frame.
    measurements
        One element per target, in reading order; NaN and a flag where a target could not be measured.
    """

    name: str
    measurements: tuple[Measurement, ...]

    def _elements(self) -> tuple[Measurement, ...]:
        return self.measurements

    def _name_of(self, element: Measurement) -> str:
        return element.target

    def _missing(self, name: str) -> str:
        return f"no target {name!r} in {self.name}"

    def __repr__(self) -> str:
        clean = [one for one in self.measurements if not one.flags and math.isfinite(one.amplitude_px)]
        largest = max((one.amplitude_px for one in clean), default=math.nan)
        return (
            f"<MotionTable {self.name}: {len(self)} targets, {len(clean)} without flags, "
            f"largest amplitude {largest:.3f} px>"
        )

    @property
    def rows(self) -> list[Row]:
        """Rows with the columns of `measurements.csv`."""
        return [measurement_row(self.name, "", one) for one in self.measurements]

    def to_csv(self) -> str:
        """The text of `measurements.csv`."""
        return csv_text(MEASUREMENT_COLUMNS, self.rows)

    def to_dataframe(self) -> pd.DataFrame:
        """The columns of `measurements.csv`, with ``amplitude_px`` and ``sd_px``, as a pandas table.

        Raises
        ------
        UsageError
            pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise UsageError("pandas is not installed; run: pip install pandas") from None
        table = pd.DataFrame(self.rows, columns=list(MEASUREMENT_COLUMNS))
        table["flags"] = [";".join(flags) for flags in table["flags"]]
        table["amplitude_px"] = np.array([one.amplitude_px for one in self.measurements])
        table["sd_px"] = np.array([one.sd_px for one in self.measurements])
        return table
