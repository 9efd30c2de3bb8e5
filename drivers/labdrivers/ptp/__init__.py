"""Cameras that speak PTP (ISO 15740) over USB.

From the wire upwards: `transport` (packets, pyusb), `container` and `datasets` (bytes to values), `session`
(transactions), `events`, `objects` and `exposure` (what a camera reports, keeps and can be set to), `find` (by serial
number), `watch` (new files), `camera` (the driver).
"""
