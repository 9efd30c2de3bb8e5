from __future__ import annotations

from labdaemon.cli.demo_modes import mode_lines

TRUTH = [{"frequency_hz": 5.4, "damping": 0.02}, {"frequency_hz": 8.5, "damping": 0.018}]


def found(frequency_hz: float, damping: float) -> dict[str, float]:
    return {"frequency_hz": frequency_hz, "sd_frequency_hz": 1e-4, "damping": damping, "sd_damping": 1e-4}


def test_modes_are_compared_with_the_nearest_true_one() -> None:
    end = {"measured": 31, "reason": "known", "modes": [found(5.40027, 0.0199), found(8.49983, 0.01827)]}
    head, _, first, second = mode_lines(end, TRUTH)
    assert "31 envelopes (known)" in head
    assert first.split() == [
        "5.4003",
        "0.0001",
        "5.4000",
        "+0.0050",
        "+2.7",
        "1.9900",
        "0.0100",
        "2.0000",
        "-0.50",
        "-1.0",
    ]
    assert second.split()[3:5] == ["-0.0020", "-1.7"]
    assert second.split()[-2:] == ["+1.50", "+2.7"]


def test_a_mode_that_is_none_is_said() -> None:
    (_, _, line) = mode_lines({"modes": [found(6.6, 0.01)]}, TRUTH)
    assert line.split() == ["6.6000", "0.0001", "none", "1.0000", "0.0100"]
    assert len(mode_lines({"reason": "the band has no mode that shows"}, TRUTH)) == 2
