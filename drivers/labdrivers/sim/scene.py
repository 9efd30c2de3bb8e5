"""What stands before the cameras: dots on paper labels, control targets, the frame's own members, things in the way.

Everything is a flat piece of something in object space (millimetres, Z up). Reflectances are fractions of the light
that falls on it; 1 would be a perfect white.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdrivers.sim.lens import FloatArray

Vector = tuple[float, float, float]

TAG_FAMILY = "apriltag-36h11"


def _on_plane(centre_mm: Vector, right: Vector, up: Vector, plane_mm: FloatArray) -> FloatArray:
    """Object points (n, 3) of points (n, 2) along `right` and `up` from a centre."""
    return np.asarray(np.asarray(centre_mm) + plane_mm @ np.array([right, up]))


@dataclass(frozen=True, slots=True)
class SceneTarget:
    """A black dot printed on a white paper label.

    Attributes
    ----------
    name
        As in results.
    centre_mm
        Of the dot, at rest.
    diameter_mm
        Of the dot.
    paper_mm
        (width, height) of the label; the dot sits in its middle.
    right, up
        Unit vectors in the label's plane.
    """

    name: str
    centre_mm: Vector
    diameter_mm: float = 8.0
    paper_mm: tuple[float, float] = (40.0, 40.0)
    right: Vector = (1.0, 0.0, 0.0)
    up: Vector = (0.0, 0.0, 1.0)

    def points(self, plane_mm: FloatArray) -> FloatArray:
        """Object points (n, 3) of points (n, 2) in the label's plane (right, up from the dot's centre)."""
        return _on_plane(self.centre_mm, self.right, self.up, plane_mm)


@dataclass(frozen=True, slots=True)
class SceneTag:
    """An AprilTag of the 36h11 family on white card: a control target.

    Attributes
    ----------
    number
        Its id.
    centre_mm
        Surveyed point.
    size_mm
        Side of the black square.
    card_mm
        Side of the white card it is printed on.
    """

    number: int
    centre_mm: Vector
    size_mm: float = 36.0
    card_mm: float = 60.0
    right: Vector = (1.0, 0.0, 0.0)
    up: Vector = (0.0, 0.0, 1.0)

    def points(self, plane_mm: FloatArray) -> FloatArray:
        """Object points (n, 3) of points (n, 2) in the card's plane (right, up from the centre)."""
        return _on_plane(self.centre_mm, self.right, self.up, plane_mm)


@dataclass(frozen=True, slots=True)
class Panel:
    """A flat member of the structure or of the lab, uniformly coloured.

    Attributes
    ----------
    corners_mm
        Four corners in order, at rest.
    reflectance
        (red, green, blue).
    moving
        Whether it moves with the structure.
    """

    corners_mm: tuple[Vector, Vector, Vector, Vector]
    reflectance: tuple[float, float, float]
    moving: bool = True


@dataclass(frozen=True, slots=True)
class Occluder:
    """Something out of focus close to the lens, given where it lies in one camera's image.

    Attributes
    ----------
    polygon_px
        Corners (x, y).
    reflectance
        Grey.
    softness_px
        Standard deviation of its edge.
    """

    polygon_px: tuple[tuple[float, float], ...]
    reflectance: float = 0.25
    softness_px: float = 2.0


@dataclass(frozen=True, slots=True)
class Scene:
    """A lab as photographed.

    Attributes
    ----------
    targets, tags, panels
        What stands there.
    paper, ink
        Reflectances of the labels and of what is printed on them.
    texture
        Relative standard deviation of the paper's reflectance, correlated over `texture_length_mm` (the Gaussian
        correlation exp(-r²/(2·length²))), fixed to the paper and moving with it.
    gradient
        (x, y) relative change of the light across the whole frame.
    vignetting
        Loss of light in the frame's corners.
    clutter
        How many things stand about before the far wall.
    seed
        Of background and paper: the same seed is the same lab.
    still_paper
        The labels stay where they are and only the dots on them move: not how labels behave, but how a dot before a
        wall does, and the simplest case for a measurement.
    """

    targets: tuple[SceneTarget, ...]
    tags: tuple[SceneTag, ...] = ()
    panels: tuple[Panel, ...] = ()
    paper: float = 0.85
    ink: float = 0.05
    texture: float = 0.004
    texture_length_mm: float = 0.3
    gradient: tuple[float, float] = (0.08, -0.05)
    vignetting: float = 0.12
    clutter: int = 150
    seed: int = 1
    still_paper: bool = False

    @classmethod
    def of(cls, scene: Scene | dict[str, Any]) -> Scene:
        """The scene itself, or one from plain values (nested mappings with the attributes' names)."""
        if isinstance(scene, Scene):
            return scene
        plain = dict(scene)
        plain["targets"] = tuple(
            t if isinstance(t, SceneTarget) else SceneTarget(**t) for t in plain.get("targets", ())
        )
        plain["tags"] = tuple(t if isinstance(t, SceneTag) else SceneTag(**t) for t in plain.get("tags", ()))
        plain["panels"] = tuple(p if isinstance(p, Panel) else Panel(**p) for p in plain.get("panels", ()))
        return cls(**plain)


@dataclass(frozen=True, slots=True, eq=False)
class TargetTruth:
    """What a target really did while the shutter was open.

    Attributes
    ----------
    name
        The target's.
    mean_mm, mean_px
        Time average of its position.
    a_mm, b_mm
        (3,) semi-amplitudes of the sine and cosine of the excitation's phase, fitted to the motion by least squares
        (zero when no frequency is given).
    a_px, b_px
        The same of the path in the image.
    moment_px2
        (2, 2) second central moment of the path in the image, whatever its law.
    """

    name: str
    mean_mm: FloatArray
    mean_px: FloatArray
    a_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    b_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    a_px: FloatArray = field(default_factory=lambda: np.zeros(2))
    b_px: FloatArray = field(default_factory=lambda: np.zeros(2))
    moment_px2: FloatArray = field(default_factory=lambda: np.zeros((2, 2)))


Mosaic = NDArray[np.uint16]
