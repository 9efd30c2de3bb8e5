"""`control.csv` and `targets.csv`: surveyed and approximate places in object space."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from labdaemon.errors import DataError


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


def _rows(path: Path, columns: tuple[str, ...]) -> list[tuple[str, list[float]]]:
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
        name = (row["name"] or "").strip()
        where = f"line {reader.line_num}"
        if not name:
            raise DataError(f"{where}: a name is missing", file=path)
        if name in seen:
            raise DataError(f"{where}: {name} is given twice", file=path)
        seen.add(name)
        if None in row:
            raise DataError(
                f"{where}: {name} has more values than the header has columns; write decimal points, not commas",
                file=path,
            )
        try:
            values = [float(row[column]) for column in columns[1:]]
        except (TypeError, ValueError):
            raise DataError(f"{where}: {name} needs numbers in {', '.join(columns[1:])}", file=path) from None
        if not all(math.isfinite(value) for value in values):
            raise DataError(f"{where}: {name} has a number that is not finite", file=path)
        rows.append((name, values))
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
        SurveyedPoint(name, *values) for name, values in _rows(path, ("name", "x_mm", "y_mm", "z_mm", "sd_mm"))
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
    places = tuple(TargetPlace(name, *values) for name, values in _rows(path, ("name", "x_mm", "y_mm", "z_mm")))
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
