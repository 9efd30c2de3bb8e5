"""`control.csv`, `targets.csv` and `patches.csv`: surveyed and approximate places, and boxes in the sharp frames."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from labdaemon.blur import MIN_SIDE_PX
from labdaemon.errors import DataError
from labdaemon.plain_file import check_plain_file


@dataclass(frozen=True, slots=True)
class SurveyedPoint:
    """Surveyed centre of a control target, mm, with the survey's standard deviation in each coordinate."""

    name: str
    x_mm: float
    y_mm: float
    z_mm: float
    sd_mm: float


@dataclass(frozen=True, slots=True)
class TargetPlace:
    """Approximate place of a monitoring target, mm: good enough to tell it from its neighbours."""

    name: str
    x_mm: float
    y_mm: float
    z_mm: float


@dataclass(frozen=True, slots=True)
class PatchBox:
    """Rectangle of a camera's sharp frame that shows a textured surface, px."""

    name: str
    camera: str
    x_px: int
    y_px: int
    width_px: int
    height_px: int

    @property
    def box(self) -> tuple[int, int, int, int]:
        """(x, y, width, height)."""
        return self.x_px, self.y_px, self.width_px, self.height_px

    @property
    def place(self) -> str:
        """The rectangle as a person writes it."""
        return ",".join(str(number) for number in self.box)


def _rows(path: Path, columns: tuple[str, ...], names: int = 1) -> list[tuple[tuple[str, ...], list[float]]]:
    """Rows of a CSV file: the first `names` columns, which together are unique, as text, the others as numbers."""
    check_plain_file(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError("file is missing", file=path) from None
    except (OSError, UnicodeDecodeError) as exc:
        raise DataError(f"cannot be read: {exc}", file=path) from None
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True)
    header = [name.strip() for name in reader.fieldnames or ()]
    missing = [name for name in columns if name not in header]
    if missing:
        raise DataError(f"no column {missing[0]}; the header must be {','.join(columns)}", file=path)
    reader.fieldnames = header
    rows, seen = [], set()
    for row in reader:
        texts = tuple((row[column] or "").strip() for column in columns[:names])
        where, name = f"line {reader.line_num}", " ".join(texts)
        for column, text in zip(columns, texts, strict=False):
            if not text:
                raise DataError(f"{where}: a {column} is missing", file=path)
        if texts in seen:
            raise DataError(f"{where}: {name} is given twice", file=path)
        seen.add(texts)
        if None in row:
            raise DataError(
                f"{where}: {name} has more values than the header has columns; write decimal points, not commas",
                file=path,
            )
        try:
            values = [float(row[column]) for column in columns[names:]]
        except (TypeError, ValueError):
            raise DataError(f"{where}: {name} needs numbers in {', '.join(columns[names:])}", file=path) from None
        if not all(math.isfinite(value) for value in values):
            raise DataError(f"{where}: {name} has a number that is not finite", file=path)
        rows.append((texts, values))
    return rows


def read_control(path: Path, size_mm: float) -> tuple[SurveyedPoint, ...]:
    """Read the surveyed control targets.

    Parameters
    ----------
    path
        CSV with columns name, x_mm, y_mm, z_mm, sd_mm.
    size_mm
        Size of a control target: centres closer together than this cannot be, so they are metres.

    Raises
    ------
    DataError
        The file is missing or malformed, has fewer than four points, a negative uncertainty, or is in metres.
    """
    points = tuple(
        SurveyedPoint(name, *values) for (name,), values in _rows(path, ("name", "x_mm", "y_mm", "z_mm", "sd_mm"))
    )
    if len(points) < 4:
        raise DataError(f"{len(points)} control targets; at least 4 are needed", file=path)
    for point in points:
        if point.sd_mm < 0:
            raise DataError(f"{point.name}: sd_mm is negative", file=path)
    closest = min(
        (math.dist((p.x_mm, p.y_mm, p.z_mm), (q.x_mm, q.y_mm, q.z_mm)), p.name, q.name)
        for p, q in combinations(points, 2)
    )
    if closest[0] < 0.7 * size_mm:
        extent = max(abs(value) for p in points for value in (p.x_mm, p.y_mm, p.z_mm))
        hint = "; are the coordinates metres?" if extent < 20 * size_mm else ""
        raise DataError(
            f"{closest[1]} and {closest[2]} are {closest[0]:.3g} mm apart, the targets {size_mm:g} mm wide{hint}",
            file=path,
        )
    return points


def read_targets(path: Path, control: tuple[SurveyedPoint, ...], size_mm: float = 0.0) -> tuple[TargetPlace, ...]:
    """Read approximate places of the monitoring targets.

    Parameters
    ----------
    path
        CSV with columns name, x_mm, y_mm, z_mm.
    control
        The surveyed control targets, none of which is a monitoring target.
    size_mm
        Their size: a monitoring target within half of it is the control target itself.

    Raises
    ------
    DataError
        The file is malformed or empty, or lies within a hand's breadth where the control spans much more: metres. A
        target has the name or the place of a control target.
    """
    places = tuple(TargetPlace(name, *values) for (name,), values in _rows(path, ("name", "x_mm", "y_mm", "z_mm")))
    if not places:
        raise DataError("names no targets; fill it or remove it", file=path)
    names = {point.name for point in control}
    for place in places:
        if place.name in names:
            raise DataError(
                f"{place.name} is a control target of control.csv too; a control target does not move, so give the "
                "monitoring target another name or remove it here",
                file=path,
            )
        for point in control:
            away = math.dist((place.x_mm, place.y_mm, place.z_mm), (point.x_mm, point.y_mm, point.z_mm))
            if away < 0.5 * size_mm:
                raise DataError(
                    f"{place.name} lies {away:.3g} mm from control target {point.name}, which is {size_mm:g} mm wide: "
                    "they are one target; remove it here or in control.csv",
                    file=path,
                )
    span = max(abs(value) for p in control for value in (p.x_mm, p.y_mm, p.z_mm))
    reach = max(abs(value) for p in places for value in (p.x_mm, p.y_mm, p.z_mm))
    if len(places) > 1 and 0 < reach < span / 100:
        raise DataError(f"all targets lie within {reach:.3g} mm of the origin; are the coordinates metres?", file=path)
    return places


def read_patches(path: Path, cameras: Sequence[str], taken: Sequence[str] = ()) -> tuple[PatchBox, ...]:
    """Read the textured patches that are measured instead of dots, or with them.

    Parameters
    ----------
    path
        CSV with columns name, camera, x_px, y_px, width_px, height_px: a row for each camera that sees the patch.
    cameras
        The rig's.
    taken
        Names of control targets and of other targets.

    Raises
    ------
    DataError
        The file is malformed or empty, names a camera that the rig does not have, has a number that is no whole one, a
        box without area, or a name that is in use.
    """
    boxes = []
    for (name, camera), values in _rows(path, ("name", "camera", "x_px", "y_px", "width_px", "height_px"), names=2):
        if camera not in cameras:
            raise DataError(f"{name}: the rig has no camera {camera}; it has {', '.join(cameras)}", file=path)
        if name in taken:
            raise DataError(f"{name} is the name of another target; give the patch a name of its own", file=path)
        if any(value != int(value) for value in values) or min(values[:2]) < 0 or min(values[2:]) < 1:
            raise DataError(
                f"{name}: x_px, y_px, width_px and height_px are whole pixels inside the sharp frame", file=path
            )
        if min(values[2:]) < MIN_SIDE_PX:
            raise DataError(f"{name}: too small to measure; make it at least {MIN_SIDE_PX} px wide and high", file=path)
        boxes.append(PatchBox(name, camera, *(int(value) for value in values)))
    if not boxes:
        raise DataError("names no patches; fill it or remove it", file=path)
    return tuple(boxes)
