"""Pixels to millimetres and back: lenses, camera orientation, intersection, adjustment. Arrays in, arrays out."""

from labdaemon.geometry.camera_motion import CameraMotion, estimate_camera_motion
from labdaemon.geometry.joint_orientation import ControlPoint, ImageObservation, JointOrientation, orient_jointly
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import ImageMotion, ObjectMotion
from labdaemon.geometry.orient import Orientation, orient
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.plane import Plane, compensate_camera_motion, fit_plane, map_motion_to_plane
from labdaemon.geometry.space_intersection import (
    IntersectedMotion,
    IntersectedTargets,
    intersect_motion,
    intersect_targets,
    resolve_ambiguous_targets,
)

__all__ = [
    "CameraMotion",
    "ControlPoint",
    "ImageMotion",
    "ImageObservation",
    "IntersectedMotion",
    "IntersectedTargets",
    "JointOrientation",
    "Lens",
    "ObjectMotion",
    "Orientation",
    "OrientedCamera",
    "Plane",
    "compensate_camera_motion",
    "estimate_camera_motion",
    "fit_plane",
    "intersect_motion",
    "intersect_targets",
    "map_motion_to_plane",
    "orient",
    "orient_jointly",
    "resolve_ambiguous_targets",
]
