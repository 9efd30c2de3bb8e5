"""What `demo` makes of a finished campaign: truth, results, overlays, accuracy and the page."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import datetime
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from labdaemon.cli.demo_lab import DemoFailed
from labdaemon.durable import write_durably
from labdaemon.orbit_size import size_mm
from labdaemon.processing import Row, read_csv
from labdaemon.report.folder_page import envelopes
from labdaemon.report.overlay import overlay_path, write_overlay

NEAR_S = 1.0
"""An exposure of the simulator belongs to a capture that opened within this time."""
TRUTH_COLUMNS = ("capture", "target", "x_mm", "y_mm", "z_mm", "ax", "ay", "az", "bx", "by", "bz")

TruthRows = dict[str, list[dict[str, Any]]]


def truth_of(envelopes: Sequence[Mapping[str, Any]], records: Sequence[Mapping[str, Any]]) -> TruthRows:
    """What every target truly did in each capture.

    Parameters
    ----------
    envelopes
        ``data`` of the envelope events.
    records
        The simulator's exposures.

    Raises
    ------
    DemoFailed
        No exposure lies near a capture.
    """
    truth: TruthRows = {}
    for envelope in envelopes:
        opened = datetime.fromisoformat(envelope["opened_at"])
        distances = [
            (abs((datetime.fromisoformat(record["opened_at"]) - opened).total_seconds()), place)
            for place, record in enumerate(records)
        ]
        if not distances or min(distances)[0] > NEAR_S:
            raise DemoFailed(f"the simulator made no exposure at {envelope['opened_at']} ({envelope['capture']})")
        targets = records[min(distances)[1]]["targets"]
        truth[envelope["capture"]] = [{"target": name, **values} for name, values in targets.items()]
    return truth


def write_truth(path: Path, truth: TruthRows) -> None:
    """`truth.csv`, to score the folder with."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(TRUTH_COLUMNS)
    for capture, rows in truth.items():
        for row in rows:
            values = (row[name if name.endswith("_mm") else f"{name}_mm"] for name in TRUTH_COLUMNS[2:])
            writer.writerow([capture, row["target"], *(f"{value:.6f}" for value in values)])
    write_durably(path, text.getvalue())


def check_same_numbers(received: Sequence[Mapping[str, Any]], results: Path) -> int:
    """Compare what came over the wire with `envelope.csv`, every cell of it.

    Returns
    -------
    int
        How many rows there are.

    Raises
    ------
    DemoFailed
        They differ.
    """
    stored = envelopes(results)
    sent = {envelope["capture"]: envelope["targets"] for envelope in received}
    if set(sent) != set(stored):
        raise DemoFailed(f"envelopes came for {', '.join(sent)}, but {results} has {', '.join(stored)}")
    for capture, rows in stored.items():
        for row, target in zip(rows, sent[capture], strict=True):
            different = [name for name, value in row.items() if name != "capture" and target.get(name) != value]
            if different:
                raise DemoFailed(f"{capture}, {row['target']}: {different[0]} differs between event and envelope.csv")
    return sum(len(rows) for rows in stored.values())


def draw_overlays(folder: Path, results: Path) -> None:
    """One image a capture and camera: the vectors on the photograph."""
    rows: dict[tuple[str, str], list[Row]] = {}
    of_capture: dict[str, list[Row]] = {}
    for row in read_csv(results / "measurements.csv"):
        rows.setdefault((str(row["capture"]), str(row["camera"])), []).append(row)
        of_capture.setdefault(str(row["capture"]), []).append(row)
    lengths = {
        capture: {str(row["target"]): size for row in found if (size := size_mm(row)) is not None}
        for capture, found in envelopes(results).items()
    }
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        tasks = [
            pool.submit(
                write_overlay,
                frame,
                of_camera,
                overlay_path(results, capture, camera),
                f"{capture}  {camera}",
                lengths.get(capture),
                of_capture[capture],
            )
            for (capture, camera), of_camera in rows.items()
            for frame in sorted((folder / "captures" / capture).glob(f"{camera}.*"))[:1]
        ]
        for task in tasks:
            task.result()


def link_folder(out: Path, folder: Path) -> None:
    """Make OUT a data-set folder too: its frames and results are the campaign's own."""
    for name in ("sharp", "captures", "results"):
        if (folder / name).exists():
            (out / name).symlink_to((folder / name).relative_to(out), target_is_directory=True)
