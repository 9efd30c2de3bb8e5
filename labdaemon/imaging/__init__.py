"""RAW file -> linear pixels -> dots and coded targets: what a sharp frame shows, found without help.

Names are imported when they are used: those who only look at a file's content need neither OpenCV nor LibRaw.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labdaemon.imaging.codes import Tag as Tag
    from labdaemon.imaging.codes import by_name as by_name
    from labdaemon.imaging.codes import centre_of as centre_of
    from labdaemon.imaging.codes import dictionary as dictionary
    from labdaemon.imaging.codes import families as families
    from labdaemon.imaging.codes import find_tags as find_tags
    from labdaemon.imaging.dots import find_dots as find_dots
    from labdaemon.imaging.eccentricity import centre_shift as centre_shift
    from labdaemon.imaging.file_tags import exposure_of as exposure_of
    from labdaemon.imaging.frame import Grey as Grey
    from labdaemon.imaging.frame import RawFrame as RawFrame
    from labdaemon.imaging.frame import mean_frame as mean_frame
    from labdaemon.imaging.lazy_image import GreyImage as GreyImage
    from labdaemon.imaging.lazy_image import LazyImage as LazyImage
    from labdaemon.imaging.naming import match_names as match_names
    from labdaemon.imaging.naming import names_by_place as names_by_place
    from labdaemon.imaging.raw import check_frame as check_frame
    from labdaemon.imaging.raw import read_frame as read_frame
    from labdaemon.imaging.rings import BITS as BITS
    from labdaemon.imaging.rings import Ring as Ring
    from labdaemon.imaging.rings import code_book as code_book
    from labdaemon.imaging.rings import find_rings as find_rings

_HOME = {
    "BITS": "labdaemon.imaging.rings",
    "Grey": "labdaemon.imaging.frame",
    "GreyImage": "labdaemon.imaging.lazy_image",
    "LazyImage": "labdaemon.imaging.lazy_image",
    "RawFrame": "labdaemon.imaging.frame",
    "Ring": "labdaemon.imaging.rings",
    "Tag": "labdaemon.imaging.codes",
    "by_name": "labdaemon.imaging.codes",
    "centre_of": "labdaemon.imaging.codes",
    "centre_shift": "labdaemon.imaging.eccentricity",
    "check_frame": "labdaemon.imaging.raw",
    "code_book": "labdaemon.imaging.rings",
    "dictionary": "labdaemon.imaging.codes",
    "exposure_of": "labdaemon.imaging.file_tags",
    "families": "labdaemon.imaging.codes",
    "find_dots": "labdaemon.imaging.dots",
    "find_rings": "labdaemon.imaging.rings",
    "find_tags": "labdaemon.imaging.codes",
    "match_names": "labdaemon.imaging.naming",
    "mean_frame": "labdaemon.imaging.frame",
    "names_by_place": "labdaemon.imaging.naming",
    "read_frame": "labdaemon.imaging.raw",
}
"""Public name -> the module that has it."""

__all__ = [
    "BITS",
    "Grey",
    "GreyImage",
    "LazyImage",
    "RawFrame",
    "Ring",
    "Tag",
    "by_name",
    "centre_of",
    "centre_shift",
    "check_frame",
    "code_book",
    "dictionary",
    "exposure_of",
    "families",
    "find_dots",
    "find_rings",
    "find_tags",
    "match_names",
    "mean_frame",
    "names_by_place",
    "read_frame",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value
