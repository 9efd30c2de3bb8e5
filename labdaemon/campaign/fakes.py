"""A measurer in memory, for simulated time: reads the frames, so that a missing or foreign one shows."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from labdaemon.campaign.measuring import Measured
from labdaemon.errors import DataError


@dataclass(slots=True)
class FakeMeasurer:
    """One target a capture, whose row tells what the fake cameras wrote.

    Attributes
    ----------
    measure_s
        Time that one measurement takes.
    poisoned
        Names of captures that cannot be measured.
    flags
        Given to every row.
    results
        What the result files would hold, by folder.
    """

    measure_s: float = 5.0
    poisoned: set[str] = field(default_factory=set)
    flags: tuple[str, ...] = ()
    amplitude_mm: float = 1.0
    results: dict[Path, list[str]] = field(default_factory=dict)

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> Measured:
        await asyncio.sleep(self.measure_s)
        if name in self.poisoned:
            raise DataError("killed its worker twice and was set aside", file=name)
        frames = [path for capture in captures for path in sorted((folder / "captures" / capture).glob("*.dng"))]
        if not frames or not list((folder / "sharp" / (sharp or "")).glob("*.dng")):
            raise DataError("has no sharp frames or no frames", file=folder / "captures" / name)
        rows = [
            {"capture": name, "target": path.stem, "ax_mm": self.amplitude_mm, "ay_mm": 0.0, "az_mm": 0.0}
            | {"flags": list(self.flags)}
            for path in frames
        ]
        return Measured(rows, [{"capture": name, "camera": path.stem} for path in frames])

    async def write_results(self, folder: Path, results: Sequence[Measured]) -> None:
        self.results[folder] = [str(result.envelope[0]["capture"]) for result in results]

    async def append_results(self, folder: Path, result: Measured) -> None:
        self.results[folder].append(str(result.envelope[0]["capture"]))
