"""A data-set folder to envelopes: what `labdaemon process` does, for notebooks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from labdaemon.envelope import Envelope, TargetEnvelope
from labdaemon.errors import UsageError
from labdaemon.named_sequence import NamedSequence
from labdaemon.processing import open_folder, process_folder

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedFolder(NamedSequence[Envelope]):
    """Envelopes of a data-set folder; a sequence of `Envelope`, one per capture or group.

    Attributes
    ----------
    out
        Folder of the result files.
    envelopes
        In the order of the captures.
    notes
        What a person should know, one line each.
    """

    out: Path
    envelopes: tuple[Envelope, ...]
    notes: tuple[str, ...] = ()

    def _elements(self) -> tuple[Envelope, ...]:
        return self.envelopes

    def _name_of(self, element: Envelope) -> str:
        return element.capture

    def _missing(self, name: str) -> str:
        return f"no capture {name!r}"

    def __repr__(self) -> str:
        return f"<ProcessedFolder {self.out}: {len(self)} envelopes>"

    def to_dataframe(self) -> pd.DataFrame:
        """All envelopes as one pandas table.

        Raises
        ------
        UsageError
            pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise UsageError("pandas is not installed; run: pip install pandas") from None
        return pd.concat([one.to_dataframe() for one in self.envelopes], ignore_index=True)


def process(
    folder: str | Path,
    *,
    out: str | Path | None = None,
    method: str | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> ProcessedFolder:
    """Measure all captures of a data-set folder and write its result files.

    Parameters
    ----------
    folder
        The data-set folder.
    out
        Folder of the result files; FOLDER/results if None.
    method
        "fit" or "paper"; the rig file's if None.
    progress
        Called with what is being done, how many parts of it are done, and of how many.

    Raises
    ------
    DataError, ConfigError
        The folder cannot be used. The message names the file.
    """
    root = Path(folder)
    result = process_folder(root, None if out is None else Path(out), method=method, progress=progress)
    opened = open_folder(root)
    envelopes = []
    for capture in result.captures:
        about = opened.capture(capture.captures[-1]).about
        targets = tuple(TargetEnvelope.from_row(row) for row in capture.envelope_rows)
        envelopes.append(Envelope(capture.name, targets, frequency_hz=about.frequency_hz, exposure_s=about.exposure_s))
    return ProcessedFolder(result.out, tuple(envelopes), result.notes)
