from __future__ import annotations

import random

from labdaemon.bench.world.fuzz import CAMPAIGN, FuzzFindings
from labdaemon.bench.world.mutations import message, mutated_bytes, mutated_text
from labdaemon.bench.world.stopping import Wire
from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.errors import LabdaemonError


def report(status: object, stderr: str = "", *, seconds: float = 0.1, memory_mb: float = 100.0) -> dict[str, object]:
    return {"status": status, "stderr": stderr, "seconds": seconds, "memory_mb": memory_mb}


def test_the_campaign_that_is_mutated_is_a_good_one():
    assert len({phase.kind for phase in load_campaign(CAMPAIGN).section.phase}) == 6


def test_mutations_follow_their_seed_and_are_refused_in_a_line():
    texts = [mutated_text(random.Random(seed), CAMPAIGN) for seed in range(60)]
    assert texts == [mutated_text(random.Random(seed), CAMPAIGN) for seed in range(60)]
    refused: list[LabdaemonError] = []
    for text in texts:
        try:
            load_campaign(text.decode("utf-8", "replace"))
        except LabdaemonError as exc:
            refused.append(exc)
    assert len(refused) > 20
    assert all("\n" not in str(exc) and exc.exit_status == 2 for exc in refused)
    assert message(random.Random(3)) == message(random.Random(3))
    assert mutated_bytes(random.Random(3), b"") in {b"", b"\0"}


def test_findings_are_judged():
    found = FuzzFindings()
    found.add("good", report(0, "a note\nanother\n"))
    found.add("refused", report(2, "labdaemon: x: is missing\n"))
    assert found.row("files").holds
    assert "1 refused, 0 not as they must be" in found.row("files").result
    for bad in (report("hang"), report(2, "two\nlines"), report(1, ""), report(0, "Traceback (most recent call last)")):
        judged = FuzzFindings()
        judged.add("bad", bad)
        assert not judged.row("files").holds
    for costly in (report(0, seconds=11.0), report(0, memory_mb=600.0)):
        judged = FuzzFindings()
        judged.add("costly", costly)
        assert not judged.row("files").holds


def test_the_first_line_that_lowers_the_level_is_found():
    wire = Wire.__new__(Wire)
    wire._passed = [(1.0, "VOLT 0.10000"), (2.0, "VOLT 0.50000"), (3.0, "FREQ?"), (4.0, "VOLT 0.60000"), (5.0, "VOLT?")]
    assert wire.lowered_s(2.5) == float("inf")
    wire._passed += [(6.0, "VOLT 0.40000"), (7.0, "OUTP OFF")]
    assert (wire.lowered_s(2.5), wire.lowered_s(6.5)) == (6.0, 7.0)
