"""The verdict on a table from what was seen of it: by example, and over all evidence there can be."""

from __future__ import annotations

from itertools import product

import pytest

from labdaemon.capture.devices import GaugeReading
from labdaemon.capture.table_evidence import TableEvidence, describe, gauge_sees_motion, judge, sights

UNKNOWN = (None, False, True)
ALL = [
    TableEvidence(*parts, line_proven=proven)
    for *parts, proven in product(UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, (False, True))
]


@pytest.mark.parametrize(
    ("evidence", "verdict"),
    [
        (TableEvidence(), "unconfirmed"),
        (TableEvidence(output_on=False), "rest"),
        (TableEvidence(output_on=True), "moving"),
        (TableEvidence(line_down=True), "unconfirmed"),  # the box's own answer proves nothing
        (TableEvidence(line_down=True, line_proven=True), "rest"),
        (TableEvidence(line_down=False, line_proven=True), "unconfirmed"),
        (TableEvidence(output_on=True, line_down=True), "moving"),
        (TableEvidence(output_on=True, line_down=True, line_proven=True), "rest"),  # as in the proof itself
        (TableEvidence(output_on=True, amplifier_on=True, line_down=True, line_proven=True), "moving"),
        (TableEvidence(output_on=True, amplifier_on=False), "rest"),
        (TableEvidence(output_on=False, gauge_moves=True), "moving"),
        (TableEvidence(gauge_moves=False), "rest"),
        (TableEvidence(output_on=True, gauge_moves=False), "moving"),
        (TableEvidence(line_down=True, line_proven=True, gauge_moves=True), "moving"),
    ],
)
def test_verdicts(evidence: TableEvidence, verdict: str):
    assert judge(evidence) == verdict


def test_rest_always_has_a_witness_and_none_against_it():
    for evidence in ALL:
        seen = set(sights(evidence).values())
        assert (judge(evidence) == "rest") == (seen == {"rest"})
        assert (judge(evidence) == "unconfirmed") == (not seen)


def test_a_moving_gauge_overrules_everything():
    assert all(judge(evidence) == "moving" for evidence in ALL if evidence.gauge_moves)


def test_without_a_proof_the_line_changes_no_verdict():
    for evidence in ALL:
        if not evidence.line_proven:
            without = TableEvidence(evidence.output_on, evidence.amplifier_on, evidence.gauge_moves)
            assert judge(evidence) == judge(without)


def test_what_was_seen_is_said():
    assert describe(TableEvidence(output_on=False, gauge_moves=True)) == "shaker: rest, gauge: moving"
    assert describe(TableEvidence()) == "nothing that can see answers"


@pytest.mark.parametrize(
    ("value", "sd", "noise_sd", "sees"),
    [
        (0.1, 0.01, 0.01, True),
        (0.02, 0.01, 0.01, False),
        (0.02, 0.01, None, None),  # how still this gauge is at rest is not known
        (0.02, 0.01, 0.001, None),  # the record holds another motion than the one that was fitted
    ],
)
def test_what_a_gauge_says(value: float, sd: float, noise_sd: float | None, sees: bool | None):
    assert gauge_sees_motion(GaugeReading(value, sd, 0.0, 0.0), noise_sd) is sees
