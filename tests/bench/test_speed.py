"""The timing's report; the times themselves are for the command to print."""

from __future__ import annotations

import json

import pytest

from labdaemon.bench.speed import SpeedResult, document, lines


@pytest.fixture
def result() -> SpeedResult:
    return SpeedResult(60, 0.04, 0.05, 0.28, 0.2, [(15, 0.05), (30, 0.1), (60, 0.2)], [(0.5, 0.03), (20.0, 0.08)], 12)


def test_lines_say_goal_and_ratio(result: SpeedResult) -> None:
    text = "\n".join(lines(result))
    assert "280.0 ms  (goal 300 ms), 7.0 x LibRaw's unpack" in text
    assert "3.33 ms a target" in text
    assert "60: 200.0 ms" in text
    assert "20 px: 80.0 ms" in text


def test_document_is_json(result: SpeedResult) -> None:
    made = json.loads(json.dumps(document(result)))
    assert made["ratio_to_unpack"] == pytest.approx(7.0)
    assert made["by_targets"][-1] == [60, 0.2]
