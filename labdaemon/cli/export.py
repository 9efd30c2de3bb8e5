"""`labdaemon export`: the envelopes of a data-set folder in the files of other tools."""

from __future__ import annotations

from pathlib import Path

import click

from labdaemon.export import CRATE, FORMATS, export_folder


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--to",
    required=True,
    multiple=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help=f"The file; its suffix chooses the format: {', '.join(FORMATS)}, or {CRATE}. Can be given several times.",
)
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), help="FOLDER/results if not given.")
def export(folder: Path, to: tuple[Path, ...], results: Path | None) -> None:
    """Write the envelopes of FOLDER as HDF5, Parquet, UFF, VTK (ParaView), MATLAB or netCDF.

    The name ro-crate-metadata.json gives a description of the whole FOLDER with the SHA-256 of each file.
    Lengths are millimetres, in UFF metres (its SI units).
    """
    for path in to:
        click.echo(f"wrote {export_folder(folder, path, results=results)}")
