"""`labdaemon calibrate camera`: photographs of a board in, the `[cameras.NAME]` table of a rig file out."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import click
import cv2
from rich.console import Console

from labdaemon.cli.progress_bars import ProgressBars
from labdaemon.durable import write_durably
from labdaemon.errors import StorageError, UsageError
from labdaemon.geometry import INTERIOR_NAMES
from labdaemon.processing import CameraCalibration, CharucoBoard, board_files, calibrate, calibrate_export, read_board
from labdaemon.report.residuals import draw_residuals


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--name", help="The camera's name in the rig file; the folder's if not given.")
@click.option("--charuco", metavar="COLSxROWS", help="The board is a ChArUco of so many squares, as 9x6.")
@click.option("--marker", default=0.75, show_default=True, help="Its markers' side, in parts of a square's.")
@click.option("--family", default="aruco-4x4-100", show_default=True, help="Its markers' family.")
@click.option("--jpeg", is_flag=True, help="Take JPEGs, for a camera that measures in JPEG.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Where to write; FOLDER/results if not given."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result for machines.")
def camera(
    folder: Path,
    name: str | None,
    charuco: str | None,
    marker: float,
    family: str,
    jpeg: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Find a camera's lens from the photographs in FOLDER, or from a PhotoModeler project's text export.

    They show a ChArUco board (--charuco) or a sheet of dots on a square grid with at least two coded rings among them.
    Take ten or more at the focus and aperture of the measurement: from all sides, tilted by 30° and more, some with
    the camera turned by 90°, and such that every corner of the frame holds points in some of them.
    """
    board = CharucoBoard.parse(charuco, marker, family) if charuco is not None else None
    name = name or (folder.stem if os.path.isfile(folder) else folder.resolve().name)
    if re.fullmatch(r"[A-Za-z0-9_-]+", name) is None:
        raise UsageError(f"{name!r} cannot be a camera's name: give one with --name, of letters, digits, _ and -")
    with ProgressBars(Console(stderr=True)) as bars:
        if os.path.isfile(folder):
            bars("adjustment", 0, 1)
            result = calibrate_export(folder)
        else:
            photographs, notes = read_board(
                board_files(folder), board, jpeg=jpeg, progress=lambda done, total: bars("photographs", done, total)
            )
            bars("adjustment", 0, 1)
            result = calibrate(photographs, notes)
        bars("adjustment", 1, 1)
    table = camera_table(name, result)
    written = _write(out or (folder.parent if os.path.isfile(folder) else folder) / "results", name, table, result)
    for line in result.left_out:
        click.echo(line, err=True)
    for line in result.warnings:
        click.echo(f"weak set: {line}", err=True)
    if as_json:
        click.echo(json.dumps(_summary(name, result, written)))
    else:
        click.echo(table, nl=False)
    click.echo(f"written to {written[0]} and {written[1]}", err=True)


def camera_table(name: str, result: CameraCalibration) -> str:
    """The `[cameras.NAME]` table, each value with its standard deviation as a comment."""
    lens, sd = result.lens, result.sd

    def numbers(values: tuple[float, ...], digits: int) -> str:
        return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"

    def standard_deviations(first: int, last: int) -> str:
        return "# sd " + ", ".join(f"{value:.2g}" for value in sd[first:last])

    k1, k2, p1, p2, k3 = 4, 5, 6, 7, 8
    spread = ", ".join(f"{sd[i]:.2g}" for i in (k1, k2, p1, p2, k3))
    return (
        f"# {len(result.files)} photographs, sigma0 {result.sigma0_px:.4f} px, "
        f"{result.degrees_of_freedom} degrees of freedom\n"
        f"[cameras.{name}]\n"
        f"image_size = [{lens.image_size[0]}, {lens.image_size[1]}]\n"
        f"focal_px = {numbers(lens.focal_px, 3)}  {standard_deviations(0, 2)}\n"
        f"principal_point_px = {numbers(lens.principal_point_px, 3)}  {standard_deviations(2, 4)}\n"
        f"distortion = {numbers(lens.distortion, 8)}  # k1 k2 p1 p2 k3, sd {spread}\n"
    )


def _summary(name: str, result: CameraCalibration, written: tuple[Path, Path]) -> dict[str, object]:
    lens = result.lens
    return {
        "camera": name,
        "image_size": lens.image_size,
        "focal_px": lens.focal_px,
        "principal_point_px": lens.principal_point_px,
        "distortion": lens.distortion,
        "sd": dict(zip(INTERIOR_NAMES, (float(value) for value in result.sd), strict=True)),
        "sigma0_px": result.sigma0_px,
        "degrees_of_freedom": result.degrees_of_freedom,
        "photographs": [file.name for file in result.files],
        "left_out": result.left_out,
        "warnings": result.warnings,
        "files": [str(path) for path in written],
    }


def _write(folder: Path, name: str, table: str, result: CameraCalibration) -> tuple[Path, Path]:
    """Write table and image, each whole or not at all."""
    toml, image = folder / f"{name}.toml", folder / f"{name}-residuals.png"
    drawn = draw_residuals(result.lens.image_size, result.image_px, result.residuals_px, result.sigma0_px, name)
    try:
        for path, content in ((toml, table.encode()), (image, cv2.imencode(".png", drawn)[1].tobytes())):
            write_durably(path, content)
    except StorageError as exc:
        raise StorageError(f"{exc}; give another folder with --out") from exc
    return toml, image
