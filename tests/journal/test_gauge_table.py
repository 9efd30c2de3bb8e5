"""gauges.csv: rows once, in any order of events, and whole after another program has written to it."""

from pathlib import Path

from labdaemon.events import GaugeMotion
from labdaemon.journal.gauge_table import GAUGE_COLUMNS, GaugeFiles, gauges_text, write_gauges

TABLE = GaugeMotion(gauge="table", role="table", unit="mm", amplitude_mm=1.25, h3_mm=1e-7, readings=500)
SILENT = GaugeMotion(gauge="response", reason='sends "nothing", since 3 s')


def test_the_text_has_empty_cells_for_what_is_unknown() -> None:
    header, first, second = gauges_text([("c1", TABLE), ("c1", SILENT)]).splitlines()
    assert header == ",".join(GAUGE_COLUMNS)
    cells = dict(zip(GAUGE_COLUMNS, first.split(","), strict=True))
    assert (cells["capture"], cells["amplitude_mm"], cells["h3_mm"], cells["readings"]) == (
        "c1",
        "1.25",
        "1e-07",
        "500",
    )
    assert cells["phase_rad"] == ""
    assert second.endswith('"sends ""nothing"", since 3 s"')


def test_rows_are_added_once(tmp_path: Path) -> None:
    files, rows = GaugeFiles(), [("c1", TABLE), ("c2", SILENT)]
    files.write(tmp_path, rows[:1])
    for _ in range(2):
        files.add(tmp_path, "c1", [TABLE], lambda: rows[:1])
        files.add(tmp_path, "c2", [SILENT], lambda: rows)
    assert (tmp_path / "gauges.csv").read_text() == gauges_text(rows)


def test_a_file_that_another_program_changed_is_written_anew(tmp_path: Path) -> None:
    files, rows = GaugeFiles(), [("c1", TABLE), ("c2", SILENT)]
    files.write(tmp_path, rows[:1])
    (tmp_path / "gauges.csv").write_text("rubbish\n")
    files.add(tmp_path, "c2", [SILENT], lambda: rows)
    assert (tmp_path / "gauges.csv").read_text() == gauges_text(rows)


def test_without_gauges_there_is_no_file(tmp_path: Path) -> None:
    files = GaugeFiles()
    files.write(tmp_path, [])
    files.add(tmp_path, "c1", [], list)
    write_gauges(tmp_path, [])
    assert not (tmp_path / "gauges.csv").exists()
