-- A journal as labdaemon 0.1.0 wrote it: its tables, one campaign, six events.
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
PRAGMA application_id = 1818321508;
PRAGMA user_version = 1;
INSERT INTO meta VALUES ('uuid', '5d0c1c8e-0000-4000-8000-000000000010');
INSERT INTO meta VALUES ('created_at', '2026-11-23T08:00:00.000000Z');
INSERT INTO campaigns VALUES ('0001-night', 1, 'night', 'name = "night"', 'd1', 'paused', 'left: no answer', '2026-11-23T08:00:01.000000Z');
INSERT INTO known_files VALUES ('left', 'DSC_0001.NEF', '2026-11-23T07:00:00');
INSERT INTO events VALUES (1, '2026-11-23T08:00:02.000000Z', 'campaign.started', '0001-night', '{"name":"night","steps":1,"predicted_s":30.5}');
INSERT INTO events VALUES (2, '2026-11-23T08:00:03.000000Z', 'step.started', '0001-night', '{"step":0,"attempt":1,"label":"5 Hz","kind":"steps","frequency_hz":5.0,"amplitude_mm":2.0}');
INSERT INTO events VALUES (3, '2026-11-23T08:00:09.250000Z', 'capture.completed', '0001-night', '{"capture":"c0001","step":0,"label":"5 Hz","sharp":false,"opened_at":"2026-11-23T08:00:05.000000Z","exposure_s":1.0,"frequency_hz":5.0,"excitation_amplitude_mm":2.0,"frames":[{"camera":"left","path":"campaigns/0001-night/captures/c0001/left.nef","size_bytes":10,"sha256":"ab"}]}');
INSERT INTO events VALUES (4, '2026-11-23T08:00:12.000000Z', 'envelope', '0001-night', '{"capture":"c0001","step":0,"label":"5 Hz","frequency_hz":5.0,"excitation_amplitude_mm":2.0,"opened_at":"2026-11-23T08:00:05.000000Z","exposure_s":1.0,"targets":[{"capture":"c0001","target":"T01","x_mm":1.0,"y_mm":2.0,"z_mm":3.0,"ax_mm":0.4,"ay_mm":0.0,"az_mm":0.3,"bx_mm":0.0,"by_mm":0.0,"bz_mm":0.0,"residual_ratio":null,"flags":["at_rest"]},{"capture":"c0001","target":"T02","x_mm":null,"flags":["not_found"]}]}');
INSERT INTO events VALUES (5, '2026-11-23T08:00:13.000000Z', 'fault', '0001-night', '{"device": "left", "error": "TransportError", "message": "left: no answer", "step": 0, "action": "pause"}');
INSERT INTO events VALUES (6, '2026-11-23T08:00:14.000000Z', 'campaign.paused', '0001-night', '{"reason":"left: no answer"}');
