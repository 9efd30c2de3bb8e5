"""`labdaemon report`: one static page about a data-set folder's results."""

from __future__ import annotations

from pathlib import Path

import click

from labdaemon.report.accuracy import read_truth
from labdaemon.report.folder_page import report_folder


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), help="FOLDER/results if not given.")
@click.option("--title", help="The folder's name if not given.")
@click.option(
    "--truth", type=click.Path(dir_okay=False, path_type=Path), help="A truth.csv to compare with (rendered folders)."
)
@click.option(
    "--compare",
    "baseline",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="BASELINE",
    help="Data-set folder of an earlier state: the page shows what changed since.",
)
def report(folder: Path, results: Path | None, title: str | None, truth: Path | None, baseline: Path | None) -> None:
    """Write a page about the results of FOLDER: envelopes, resonances, overlays, every target with its flags."""
    known = read_truth(truth) if truth is not None else None
    page, _ = report_folder(
        folder, title=title or folder.resolve().name, truth=known, results=results, baseline=baseline
    )
    click.echo(f"report in {page}")
