"""How far a target moves, as one number: the semi-major axis of its orbit, from a *and* b.

Interlocks, status, progress, pages and benches all call this module, so that one motion has one size everywhere. It
needs no numpy: the command line reports a status without loading it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from labdaemon.flags import Flag

HARMLESS = frozenset({Flag.AT_REST.value, Flag.CONTRADICTS_GROUP.value})
"""Flags that leave no doubt about the size.

A target at rest moves less than the detection limit. Captures of a group that contradict each other differ by more than
their sd, as while the structure still rings, but the target moved in each of them: an interlock must see it.
"""

Vector = tuple[float, ...]


def semi_major_axis(a: Sequence[float], b: Sequence[float]) -> float:
    """Largest distance from the mean on the path ``a·sin ωt + b·cos ωt``.

    The root of the larger eigenvalue of ``aaᵀ + bbᵀ``; in the unit of a and b, (d,) each.
    """
    aa, bb, ab = _dot(a, a), _dot(b, b), _dot(a, b)
    return math.sqrt((aa + bb) / 2 + math.hypot((aa - bb) / 2, ab))


def semi_axes(a: Sequence[float], b: Sequence[float]) -> tuple[Vector, Vector]:
    """Major and minor semi-axis of the path, (d,) each: the two conjugate vectors at right angles."""
    turn = 0.5 * math.atan2(2.0 * _dot(a, b), _dot(a, a) - _dot(b, b))
    cos, sin = math.cos(turn), math.sin(turn)
    major = tuple(cos * x + sin * y for x, y in zip(a, b, strict=True))
    minor = tuple(cos * y - sin * x for x, y in zip(a, b, strict=True))
    return (major, minor) if _dot(major, major) >= _dot(minor, minor) else (minor, major)


def vectors_mm(row: Mapping[str, Any]) -> tuple[Vector, Vector] | None:
    """Vectors a and b (3,) of a row of an envelope, millimetres; None where it has no numbers.

    A component of b that one camera cannot show is empty and counts as 0.
    """
    values = [row.get(f"a{axis}_mm") for axis in "xyz"]
    if any(value is None or not math.isfinite(value) for value in values):
        return None
    others = [row.get(f"b{axis}_mm") for axis in "xyz"]
    b = tuple(0.0 if value is None or not math.isfinite(value) else float(value) for value in others)
    return tuple(float(value) for value in values if value is not None), b


def size_mm(row: Mapping[str, Any]) -> float | None:
    """Semi-major axis of a row of an envelope, millimetres; None where the target was not measured."""
    vectors = vectors_mm(row)
    return None if vectors is None else semi_major_axis(*vectors)


def is_doubtful(row: Mapping[str, Any]) -> bool:
    """Whether a flag of the row leaves its size in doubt."""
    return bool(set(row.get("flags") or ()) - HARMLESS)


@dataclass(frozen=True, slots=True)
class LargestMotion:
    """The largest motion of an envelope, by the targets without a doubt.

    Attributes
    ----------
    size_mm, target
        Of the largest target without a flag (`at_rest` aside); None where there is no such target.
    doubtful
        Targets with a number and a flag that puts it in doubt.
    doubtful_mm, doubtful_target
        The largest of these; None without any.
    measured
        Targets with a number.
    """

    size_mm: float | None
    target: str | None
    doubtful: int
    doubtful_mm: float | None
    doubtful_target: str | None
    measured: int

    def text(self) -> str:
        """`largest 0.411 mm at T07; 1 doubtful`, or what is left to say; empty where nothing was measured."""
        doubt = f"{self.doubtful} doubtful" if self.doubtful else ""
        if self.size_mm is not None:
            return f"largest {self.size_mm:.3f} mm at {self.target}" + (f"; {doubt}" if doubt else "")
        if self.doubtful_mm is not None:
            return f"all {doubt}, the largest of these {self.doubtful_mm:.3f} mm at {self.doubtful_target}"
        return ""


def largest_motion(rows: Iterable[Mapping[str, Any]]) -> LargestMotion:
    """The headline of an envelope's rows: targets without a flag come first, doubtful ones are counted apart."""
    clean: list[tuple[float, str]] = []
    doubtful: list[tuple[float, str]] = []
    for row in rows:
        size = size_mm(row)
        if size is not None:
            (doubtful if is_doubtful(row) else clean).append((size, str(row.get("target"))))
    best, worst = max(clean, default=(None, None)), max(doubtful, default=(None, None))
    return LargestMotion(best[0], best[1], len(doubtful), worst[0], worst[1], len(clean) + len(doubtful))


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(one, other, strict=True))
