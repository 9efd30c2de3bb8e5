"""What a data-set folder holds, read once for every format: envelopes, and what is known of each capture."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from labdaemon.envelope import Envelope, TargetEnvelope
from labdaemon.errors import DataError
from labdaemon.processing import RESULTS, CaptureFacts, Row, capture_facts, check_captures, read_csv


@dataclass(frozen=True, slots=True)
class FolderResults:
    """Envelopes of a folder.

    Attributes
    ----------
    folder
        The data-set folder.
    envelopes
        In the order of `envelope.csv`.
    facts
        One for each envelope, in the same order.
    """

    folder: Path
    envelopes: tuple[Envelope, ...]
    facts: tuple[CaptureFacts, ...] = field(default=())

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of all targets, in the order in which they first occur."""
        return tuple(dict.fromkeys(one.target for envelope in self.envelopes for one in envelope.targets))


def read_results(folder: Path, results: Path | None = None) -> FolderResults:
    """Read `envelope.csv` and the capture files of a data-set folder.

    Parameters
    ----------
    folder
        The data-set folder.
    results
        Folder of the result files; FOLDER/results if None.

    Raises
    ------
    DataError
        There are no results, or they cannot be read. The message names the file.
    """
    if not os.path.isdir(folder):
        raise DataError("is not a folder", file=folder)
    path = (results or folder / RESULTS) / "envelope.csv"
    if not os.path.isfile(path):
        raise DataError("is not there; run `labdaemon process` on the folder first", file=path)
    captures: dict[str, list[Row]] = {}
    for row in read_csv(path):
        captures.setdefault(str(row["capture"]), []).append(row)
    if not captures:
        raise DataError("holds no envelope yet", file=path)
    facts = capture_facts(folder)
    check_captures(folder, captures, facts)
    known = tuple(facts.get(name, CaptureFacts(captures=(name,))) for name in captures)
    envelopes = tuple(
        Envelope(
            name,
            tuple(TargetEnvelope.from_row(row) for row in rows),
            frequency_hz=about.frequency_hz,
            excitation_amplitude_mm=about.excitation_amplitude_mm,
            exposure_s=about.exposure_s,
            opened_at=about.opened_at,
        )
        for (name, rows), about in zip(captures.items(), known, strict=True)
    )
    return FolderResults(folder, envelopes, known)
