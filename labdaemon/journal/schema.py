"""The journal's tables, and which version of them this program reads.

States change only together with the event that reports it (see `labdaemon.journal.transitions`), so whoever has read
all events knows the state, and a crash can leave neither without the other.
"""

from __future__ import annotations

VERSION = 1
"""Kept in SQLite's ``user_version``. A journal of a newer version is refused: its meaning is unknown here."""

APPLICATION_ID = 0x6C616264
"""``labd`` in SQLite's ``application_id``, so that another program's database is not taken for a journal."""

TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE campaigns (
    id TEXT PRIMARY KEY,
    number INTEGER NOT NULL UNIQUE,
    name TEXT NOT NULL,
    toml TEXT NOT NULL,
    digest TEXT NOT NULL,
    state TEXT NOT NULL,
    reason TEXT,
    submitted_at TEXT NOT NULL
) STRICT;
CREATE TABLE steps (
    campaign TEXT NOT NULL REFERENCES campaigns(id),
    step INTEGER NOT NULL,
    state TEXT NOT NULL,
    attempts INTEGER NOT NULL,
    reason TEXT,
    PRIMARY KEY (campaign, step)
) STRICT, WITHOUT ROWID;
CREATE TABLE captures (
    campaign TEXT NOT NULL REFERENCES campaigns(id),
    name TEXT NOT NULL,
    step INTEGER NOT NULL,
    shot INTEGER NOT NULL,
    label TEXT NOT NULL,
    is_sharp INTEGER NOT NULL,
    sharp TEXT,
    grouped TEXT,
    state TEXT NOT NULL,
    frequency_hz REAL,
    amplitude_mm REAL,
    exposure_s REAL NOT NULL,
    opened_at TEXT,
    opening TEXT NOT NULL DEFAULT '{}',
    phase_rad REAL,
    sd_phase_rad REAL,
    cameras TEXT NOT NULL,
    files TEXT NOT NULL DEFAULT '{}',
    reason TEXT,
    PRIMARY KEY (campaign, name)
) STRICT, WITHOUT ROWID;
CREATE INDEX captures_of_step ON captures (campaign, step);
CREATE INDEX captures_in_state ON captures (state, campaign);
CREATE TABLE frames (
    id INTEGER PRIMARY KEY,
    campaign TEXT NOT NULL,
    capture TEXT NOT NULL,
    camera TEXT NOT NULL,
    path TEXT NOT NULL UNIQUE,
    card_name TEXT NOT NULL,
    captured_at TEXT NOT NULL,
    size_bytes INTEGER NOT NULL,
    sha256 TEXT NOT NULL,
    state TEXT NOT NULL
) STRICT;
CREATE INDEX frames_on_card ON frames (camera, card_name, captured_at);
CREATE INDEX frames_of_capture ON frames (campaign, capture);
CREATE TABLE known_files (
    camera TEXT NOT NULL,
    card_name TEXT NOT NULL,
    captured_at TEXT NOT NULL,
    PRIMARY KEY (camera, card_name, captured_at)
) STRICT, WITHOUT ROWID;
CREATE TABLE results (
    campaign TEXT NOT NULL,
    name TEXT NOT NULL,
    number INTEGER NOT NULL,
    envelope TEXT NOT NULL,
    measurements TEXT NOT NULL,
    PRIMARY KEY (campaign, name)
) STRICT, WITHOUT ROWID;
CREATE INDEX results_in_order ON results (campaign, number);
CREATE TABLE requests (
    request_id TEXT PRIMARY KEY,
    method TEXT NOT NULL,
    reply TEXT NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE events (
    seq INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    kind TEXT NOT NULL,
    campaign TEXT,
    data TEXT NOT NULL
) STRICT;
CREATE INDEX events_of_campaign ON events (campaign, kind);
"""

LATER_INDEX = "CREATE INDEX IF NOT EXISTS campaigns_in_state ON campaigns (state, number)"
"""Counts queued campaigns each second without reading their texts. Made for journals of before it, too."""
LIGHT_TABLE = """
CREATE TABLE IF NOT EXISTS capture_lights (
    campaign TEXT NOT NULL,
    capture TEXT NOT NULL,
    light TEXT NOT NULL,
    PRIMARY KEY (campaign, capture)
) STRICT, WITHOUT ROWID
"""
"""Light codes that were played (`labdaemon.journal.light_record`). Made for journals of before it, too."""
GAUGE_TABLE = """
CREATE TABLE IF NOT EXISTS gauge_motions (
    campaign TEXT NOT NULL,
    capture TEXT NOT NULL,
    gauge TEXT NOT NULL,
    motion TEXT NOT NULL,
    PRIMARY KEY (campaign, capture, gauge)
) STRICT, WITHOUT ROWID
"""
"""What gauges saw during captures (`labdaemon.events.GaugeMotion` as JSON). Made for journals of before it, too."""
DECISION_TABLE = """
CREATE TABLE IF NOT EXISTS step_decisions (
    campaign TEXT NOT NULL,
    step INTEGER NOT NULL,
    decision TEXT NOT NULL,
    PRIMARY KEY (campaign, step)
) STRICT, WITHOUT ROWID
"""
"""Decisions of searches for modes (`labdaemon.events.DecisionData` as JSON). Made for journals of before it, too."""
QUEUE_TABLE = """
CREATE TABLE IF NOT EXISTS queue_places (campaign TEXT PRIMARY KEY, place INTEGER NOT NULL) STRICT, WITHOUT ROWID
"""
"""Campaigns that a person has moved (`labdaemon.journal.queue_order`). Made for journals of before it, too."""
CARD_TABLES = """
CREATE TABLE card_files (
    camera TEXT NOT NULL,
    card_name TEXT NOT NULL,
    captured_at TEXT NOT NULL,
    handle INTEGER NOT NULL,
    size_bytes INTEGER NOT NULL,
    is_copied INTEGER NOT NULL,
    PRIMARY KEY (camera, card_name, captured_at, handle, size_bytes)
) STRICT, WITHOUT ROWID;
CREATE TABLE owed_files (
    camera TEXT NOT NULL,
    campaign TEXT NOT NULL,
    capture TEXT NOT NULL,
    opened_at TEXT NOT NULL,
    exposure_s REAL NOT NULL,
    PRIMARY KEY (camera, campaign, capture)
) STRICT, WITHOUT ROWID;
CREATE TABLE camera_clocks (
    camera TEXT PRIMARY KEY,
    offset_s REAL NOT NULL,
    sd_s REAL NOT NULL,
    exposure_s REAL NOT NULL,
    measured_at TEXT NOT NULL
) STRICT, WITHOUT ROWID;
INSERT OR IGNORE INTO card_files SELECT camera, card_name, captured_at, -1, -1, 0 FROM known_files;
INSERT OR IGNORE INTO card_files SELECT camera, card_name, captured_at, -1, size_bytes, 1 FROM frames
"""
"""Of cards and cameras' clocks (`labdaemon.journal.card_records`): added to a journal of version 0.1.0, which knew
files by name and time alone and can still be read by the labdaemon that wrote it."""
