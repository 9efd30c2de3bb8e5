"""Where rendered frames come from: a simulator found by its entry point, known here only by what it is called with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol, cast

from labdaemon.blur import FloatArray
from labdaemon.errors import UsageError

GROUP = "labdaemon.simulators"

Motion = Callable[[FloatArray], FloatArray]
"""Times (n,) s -> displacement (n, 3) mm."""


class RenderedImage(Protocol):
    """A frame as rendered."""

    @property
    def mean_dn(self) -> Any:
        """(h, w) expected counts above black, without noise."""
        ...


class Renderer(Protocol):
    """Renders one frame from plain values; keys as the simulator's own scene and camera have them."""

    def __call__(
        self,
        scene: Mapping[str, Any],
        camera: Mapping[str, Any],
        *,
        motions: Mapping[str, Motion] | None = None,
        white_dn: float = 2900.0,
        optics: Mapping[str, Any] | None = None,
        sensor: Mapping[str, Any] | None = None,
    ) -> RenderedImage:
        """One frame."""
        ...


class FolderMaker(Protocol):
    """Writes a data-set folder with `truth.csv`."""

    def __call__(self, path: Path, **options: Any) -> Path:
        """The folder."""
        ...


def renderer() -> Renderer:
    """The installed renderer.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    return cast(Renderer, _load("renderer"))


def folder_maker() -> FolderMaker:
    """The installed maker of data-set folders.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    return cast(FolderMaker, _load("folder"))


def _load(name: str) -> object:
    for point in entry_points(group=GROUP, name=name):
        return point.load()
    raise UsageError(f"no simulator offers {name!r} (entry point group {GROUP}); install the simulated drivers")
