"""labdaemon: shaker, synchronised cameras, and vibration measured from motion blur.

>>> import labdaemon as ld
>>> motion = ld.measure("sharp.nef", "blurred.nef")     # doctest: +SKIP
>>> result = ld.process("FOLDER")                       # doctest: +SKIP
>>> with ld.Client() as lab:                            # doctest: +SKIP
...     lab.capture(label="first")

Names are imported when they are used, so that a command such as ``labdaemon stop`` starts at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from labdaemon.version import __version__ as __version__

if TYPE_CHECKING:
    from labdaemon import errors as errors
    from labdaemon import events as events
    from labdaemon import flags as flags
    from labdaemon.analysis import MotionTable as MotionTable
    from labdaemon.analysis import ProcessedFolder as ProcessedFolder
    from labdaemon.analysis import frame_from_array as frame_from_array
    from labdaemon.analysis import measure as measure
    from labdaemon.analysis import process as process
    from labdaemon.analysis import read_frame as read_frame
    from labdaemon.blur import ExposureWindow as ExposureWindow
    from labdaemon.blur import Measurement as Measurement
    from labdaemon.envelope import Envelope as Envelope
    from labdaemon.envelope import TargetEnvelope as TargetEnvelope
    from labdaemon.errors import LabdaemonError as LabdaemonError
    from labdaemon.events import Event as Event
    from labdaemon.events import parse_event as parse_event
    from labdaemon.flags import Flag as Flag
    from labdaemon.imaging import RawFrame as RawFrame
    from labdaemon.stream.async_client import AsyncClient as AsyncClient
    from labdaemon.stream.client import Client as Client

_HOME = {
    "AsyncClient": "labdaemon.stream.async_client",
    "Client": "labdaemon.stream.client",
    "Envelope": "labdaemon.envelope",
    "Event": "labdaemon.events",
    "Flag": "labdaemon.flags",
    "LabdaemonError": "labdaemon.errors",
    "Measurement": "labdaemon.blur",
    "MotionTable": "labdaemon.analysis",
    "ProcessedFolder": "labdaemon.analysis",
    "RawFrame": "labdaemon.imaging.frame",
    "TargetEnvelope": "labdaemon.envelope",
    "ExposureWindow": "labdaemon.blur",
    "frame_from_array": "labdaemon.analysis",
    "measure": "labdaemon.analysis",
    "parse_event": "labdaemon.events",
    "process": "labdaemon.analysis",
    "read_frame": "labdaemon.analysis",
}
"""Public name -> the module that has it."""

__all__ = [
    "AsyncClient",
    "Client",
    "Envelope",
    "Event",
    "ExposureWindow",
    "Flag",
    "LabdaemonError",
    "Measurement",
    "MotionTable",
    "ProcessedFolder",
    "RawFrame",
    "TargetEnvelope",
    "__version__",
    "errors",
    "events",
    "flags",
    "frame_from_array",
    "measure",
    "parse_event",
    "process",
    "read_frame",
]


def __getattr__(name: str) -> Any:
    if name in ("errors", "events", "flags"):
        return import_module(f"labdaemon.{name}")
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'labdaemon' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
