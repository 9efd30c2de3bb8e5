"""Events as documents of bluesky's event model: start, descriptor, event, stream_resource, stream_datum, stop.

A campaign is a run; so is each capture, or group of captures, outside any. A run has the streams ``captures`` (one
event a capture, its RAW frames as external data) and ``envelopes`` (one event an envelope, a column of `envelope.csv`
under each key). All uids follow from the journal and the event, so that documents which are made again are the same.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, TypeAlias
from uuid import UUID, uuid5

from labdaemon.journal.transitions import MANUAL

Document: TypeAlias = tuple[str, dict[str, Any]]
"""Name and content."""
NAMESPACE = UUID("5e0cf1d0-53f5-4e3c-9f0f-7a6c1c0f2b11")
OBJECT = "labdaemon"
MOST_OPEN = 100
"""Runs outside campaigns whose envelope is still to come; of more, the oldest ends as failed."""
ENDS = {"campaign.completed": "success", "campaign.aborted": "abort", "campaign.failed": "fail"}
CAPTURE_KEYS: dict[str, dict[str, Any]] = {
    "capture": {"dtype": "string", "shape": []},
    "label": {"dtype": "string", "shape": []},
    "group": {"dtype": "string", "shape": []},
    "sharp": {"dtype": "boolean", "shape": []},
    "frequency_hz": {"dtype": "number", "shape": [], "units": "Hz"},
    "excitation_amplitude_mm": {"dtype": "number", "shape": [], "units": "mm"},
    "phase_rad": {"dtype": "number", "shape": [], "units": "rad"},
    "exposure_s": {"dtype": "number", "shape": [], "units": "s"},
    "opened_at": {"dtype": "string", "shape": []},
}
ENVELOPE_KEYS = {name: CAPTURE_KEYS[name] for name in CAPTURE_KEYS if name not in {"group", "sharp", "phase_rad"}}
TEXT_COLUMNS = ("target", "flags")
FRAME_TEXTS = ("path", "sha256")
"""What an event says of each camera's file."""


@dataclass(slots=True)
class OpenRun:
    """A run whose stop is still to come.

    Attributes
    ----------
    uid
        Of its start.
    first_seq
        Of the event that began it.
    descriptors
        uid of each stream's descriptor, by what it describes.
    counts
        Events of each stream.
    resources
        uid of each camera's resource.
    frames
        Frames of each camera.
    """

    uid: str
    first_seq: int
    descriptors: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    resources: dict[str, str] = field(default_factory=dict)
    frames: dict[str, int] = field(default_factory=dict)


class DocumentMaker:
    """Makes documents of events, in the order of the events.

    Parameters
    ----------
    data
        The daemon's data folder, which frames' paths are relative to; None where it is not known.
    """

    def __init__(self, data: Path | None = None) -> None:
        self._data = data
        self._runs: OrderedDict[str, OpenRun] = OrderedDict()

    @property
    def first_open_seq(self) -> int | None:
        """`seq` of the first event of the oldest open run; None where none is open."""
        return min((run.first_seq for run in self._runs.values()), default=None)

    def feed(self, event: dict[str, Any]) -> Iterator[Document]:
        """Documents of one event; none for a status, a step or a fault."""
        kind, campaign = event["kind"], event["campaign"]
        is_manual = campaign is None or campaign == MANUAL
        if kind == "capture.completed":
            yield from self._capture(event, self._key(event) if is_manual else campaign, is_manual)
        elif kind == "envelope":
            yield from self._envelope(event, self._key(event) if is_manual else campaign, is_manual)
        elif kind == "campaign.started" and campaign is not None:
            yield from self._start(event, campaign)
        elif kind in ENDS and campaign in self._runs:
            yield self._stop(event, campaign, ENDS[kind], str(event["data"].get("reason") or ""))
        elif kind == "fault" and is_manual and (key := self._key(event)) in self._runs:
            yield self._stop(event, key, "fail", str(event["data"].get("message") or ""))

    def _key(self, event: dict[str, Any]) -> str:
        data = event["data"]
        return f"{event['journal']}:{data.get('group') or data.get('capture') or ''}"

    def _start(self, event: dict[str, Any], key: str) -> Iterator[Document]:
        """A run's start, unless it is open already."""
        if key in self._runs:
            return
        uid = _uid(event, "start", key)
        self._runs[key] = OpenRun(uid, event["seq"])
        start: dict[str, Any] = {
            "uid": uid,
            "time": _time(event),
            "plan_name": "labdaemon",
            "journal": event["journal"],
        }
        start |= {"campaign": event["campaign"] or "", "labdaemon_seq": event["seq"]}
        data = event["data"]
        if event["kind"] == "campaign.started":
            start |= {"campaign_name": data.get("name") or "", "num_steps": data.get("steps") or 0}
        yield "start", start

    def _stop(self, event: dict[str, Any], key: str, status: str, reason: str) -> Document:
        run = self._runs.pop(key)
        return "stop", {
            "uid": _uid(event, "stop", run.uid),
            "time": _time(event),
            "run_start": run.uid,
            "exit_status": status,
            "reason": reason,
            "num_events": dict(run.counts),
        }

    def _capture(self, event: dict[str, Any], key: str, is_manual: bool) -> Iterator[Document]:
        yield from self._start(event, key)
        run, data = self._runs[key], event["data"]
        cameras = {_camera_key(frame["camera"]): frame for frame in data.get("frames") or ()}
        keys = dict(CAPTURE_KEYS)
        for name in cameras:
            keys[name] = {"dtype": "array", "shape": [1], "dtype_numpy": "|u1", "external": "STREAM:"}
            keys |= {f"{name}_{what}": {"dtype": "string", "shape": []} for what in FRAME_TEXTS}
        yield from self._described(event, run, "captures", keys)
        descriptor = run.descriptors[_signature("captures", keys)]
        seq_num = run.counts.get("captures", 0) + 1
        values = {name: _scalar(data.get(name), about) for name, about in CAPTURE_KEYS.items()}
        for name, frame in cameras.items():
            yield from self._frame(event, run, descriptor, name, frame, seq_num)
            values |= {f"{name}_path": str(self._path(frame)), f"{name}_sha256": str(frame.get("sha256") or "")}
        yield self._event(event, run, "captures", descriptor, values)
        if is_manual and data.get("sharp"):
            yield self._stop(event, key, "success", "")
        while is_manual and len(self._runs) > MOST_OPEN:
            yield self._stop(event, next(iter(self._runs)), "fail", "it was not measured")

    def _frame(
        self, event: dict[str, Any], run: OpenRun, descriptor: str, name: str, frame: dict[str, Any], seq_num: int
    ) -> Iterator[Document]:
        """One RAW file: a datum of its camera's resource. Where the file lies is in the event."""
        place = run.frames.get(name, 0)
        run.frames[name] = place + 1
        if name not in run.resources:
            run.resources[name] = _uid(event, "resource", f"{run.uid}:{name}")
            yield (
                "stream_resource",
                {
                    "uid": run.resources[name],
                    "run_start": run.uid,
                    "data_key": name,
                    "mimetype": "application/octet-stream",
                    "uri": f"file://localhost/{str(self._campaign_folder(frame)).lstrip('/')}/",
                    "parameters": {"join_method": "stack", "chunk_shape": [1], "template": f"{{{name}_path}}"},
                },
            )
        yield (
            "stream_datum",
            {
                "uid": f"{run.resources[name]}/{place}",
                "stream_resource": run.resources[name],
                "descriptor": descriptor,
                "indices": {"start": place, "stop": place + 1},
                "seq_nums": {"start": seq_num, "stop": seq_num + 1},
            },
        )

    def _path(self, frame: dict[str, Any]) -> Path:
        path = Path(frame["path"])
        return self._data / path if self._data is not None else path

    def _campaign_folder(self, frame: dict[str, Any]) -> Path:
        """The data-set folder of a frame: ``campaigns/ID``. All frames of a run lie in one."""
        folder = Path(*Path(frame["path"]).parts[:2])
        return self._data / folder if self._data is not None else folder

    def _envelope(self, event: dict[str, Any], key: str, is_manual: bool) -> Iterator[Document]:
        yield from self._start(event, key)
        run, data = self._runs[key], event["data"]
        rows = data.get("targets") or []
        columns = [name for name in (rows[0] if rows else ()) if name not in {*TEXT_COLUMNS, "capture"}]
        keys = dict(ENVELOPE_KEYS)
        keys |= {name: {"dtype": "array", "shape": [len(rows)], "dtype_numpy": "<U64"} for name in TEXT_COLUMNS}
        for name in columns:
            unit = {"units": "mm"} if name.endswith("_mm") else {}
            keys[name] = {"dtype": "array", "shape": [len(rows)], "dtype_numpy": "<f8"} | unit
        yield from self._described(event, run, "envelopes", keys)
        values: dict[str, Any] = {name: _scalar(data.get(name), about) for name, about in ENVELOPE_KEYS.items()}
        values["target"] = [str(row["target"]) for row in rows]
        values["flags"] = [";".join(row.get("flags") or ()) for row in rows]
        values |= {name: [_number(row.get(name)) for row in rows] for name in columns}
        yield self._event(event, run, "envelopes", run.descriptors[_signature("envelopes", keys)], values)
        if is_manual:
            yield self._stop(event, key, "success", "")

    def _described(
        self, event: dict[str, Any], run: OpenRun, stream: str, keys: dict[str, dict[str, Any]]
    ) -> Iterator[Document]:
        """A stream's descriptor, where it has none for these keys yet."""
        signature = _signature(stream, keys)
        if signature in run.descriptors:
            return
        uid = _uid(event, "descriptor", f"{run.uid}:{signature}")
        run.descriptors[signature] = uid
        data_keys = {
            name: {"source": f"labdaemon:{stream}", "object_name": OBJECT} | about for name, about in keys.items()
        }
        yield (
            "descriptor",
            {
                "uid": uid,
                "time": _time(event),
                "run_start": run.uid,
                "name": stream,
                "data_keys": data_keys,
                "object_keys": {OBJECT: list(keys)},
                "configuration": {},
                "hints": {OBJECT: {"fields": []}},
            },
        )

    def _event(
        self, event: dict[str, Any], run: OpenRun, stream: str, descriptor: str, values: dict[str, Any]
    ) -> Document:
        run.counts[stream] = run.counts.get(stream, 0) + 1
        return "event", {
            "uid": _uid(event, "event", run.uid),
            "time": _time(event),
            "seq_num": run.counts[stream],
            "descriptor": descriptor,
            "data": values,
            "timestamps": dict.fromkeys(values, _time(event)),
            "filled": {},
        }


def _uid(event: dict[str, Any], kind: str, name: str) -> str:
    return str(uuid5(NAMESPACE, f"{event['journal']}:{event['seq']}:{kind}:{name}"))


def _signature(stream: str, keys: dict[str, dict[str, Any]]) -> str:
    return stream + ":" + ",".join(f"{name}{about['shape']}" for name, about in keys.items())


def _camera_key(camera: str) -> str:
    return f"frame_{camera}"


def _time(event: dict[str, Any]) -> float:
    return datetime.fromisoformat(event["at"]).timestamp()


def _scalar(value: Any, about: dict[str, Any]) -> Any:
    """A value of its key's type: what is not known is NaN, or empty."""
    match about["dtype"]:
        case "number":
            return _number(value)
        case "boolean":
            return bool(value)
    return "" if value is None else str(value)


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
