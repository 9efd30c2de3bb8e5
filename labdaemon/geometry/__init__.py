"""Pixels to millimetres and back: lenses, camera orientation, intersection, adjustment. Arrays in, arrays out."""

from labdaemon.geometry.camera_motion import CameraMotion, camera_motion
from labdaemon.geometry.join import Joined, JoinedTargets, join, join_targets, settle_by_continuity
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import ImageMotion, ObjectMotion
from labdaemon.geometry.orient import Orientation, orient
from labdaemon.geometry.plane import Plane, fit_plane, motion_on_plane, seen_unmoved
from labdaemon.geometry.together import ControlPoint, Sighting, Together, orient_together
from labdaemon.geometry.view import View

__all__ = [
    "CameraMotion",
    "ControlPoint",
    "ImageMotion",
    "Joined",
    "JoinedTargets",
    "Lens",
    "ObjectMotion",
    "Orientation",
    "Plane",
    "Sighting",
    "Together",
    "View",
    "camera_motion",
    "fit_plane",
    "join",
    "join_targets",
    "motion_on_plane",
    "orient",
    "orient_together",
    "seen_unmoved",
    "settle_by_continuity",
]
