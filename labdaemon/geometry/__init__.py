"""Pixels to millimetres and back: lenses, camera orientation, intersection, adjustment. Arrays in, arrays out."""

from labdaemon.geometry.brown import forward_from_backward
from labdaemon.geometry.camera_motion import CameraMotion, estimate_camera_motion
from labdaemon.geometry.joint_orientation import ControlPoint, ImageObservation, JointOrientation, orient_jointly
from labdaemon.geometry.lattice import Node, apply_placement, grow_lattice, place_lattices
from labdaemon.geometry.lens import INTERIOR_NAMES, Lens
from labdaemon.geometry.motion import ImageMotion, IntersectedMotion, ObjectMotion
from labdaemon.geometry.network import Network, Pose
from labdaemon.geometry.orientation import Orientation, orient
from labdaemon.geometry.oriented_camera import OrientedCamera, rotation_from_vector
from labdaemon.geometry.photomodeler_export import read_photomodeler
from labdaemon.geometry.plane import Plane, compensate_camera_motion, fit_plane, map_motion_to_plane
from labdaemon.geometry.reliability import GrossError, adjust_without_gross_errors, select_observations
from labdaemon.geometry.resolution import resolve_ambiguous_targets
from labdaemon.geometry.space_intersection import (
    IntersectedTargets,
    intersect_motion,
    intersect_targets,
)

__all__ = [
    "INTERIOR_NAMES",
    "CameraMotion",
    "ControlPoint",
    "GrossError",
    "ImageMotion",
    "ImageObservation",
    "IntersectedMotion",
    "IntersectedTargets",
    "JointOrientation",
    "Lens",
    "Network",
    "Node",
    "ObjectMotion",
    "Orientation",
    "OrientedCamera",
    "Plane",
    "Pose",
    "adjust_without_gross_errors",
    "apply_placement",
    "compensate_camera_motion",
    "estimate_camera_motion",
    "fit_plane",
    "forward_from_backward",
    "grow_lattice",
    "intersect_motion",
    "intersect_targets",
    "map_motion_to_plane",
    "orient",
    "orient_jointly",
    "place_lattices",
    "read_photomodeler",
    "resolve_ambiguous_targets",
    "rotation_from_vector",
    "select_observations",
]
