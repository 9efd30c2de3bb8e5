from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import ConfigError, DeviceRefused, ProtocolError, TransportError, UsageError
from labdaemon.record_range import clipped_ends
from labdaemon.sine_fit import change_per_cycle, fit_free_sine, fit_sine
from labdrivers.gauge import LineGauge
from labdrivers.gauge_stream import LineParser, RecordParser
from labdrivers.sim.gauge_device import GaugeDevice
from labdrivers.sim.wire import PtyPort, TcpPort


@settings(max_examples=60, deadline=None)
@given(st.floats(0.5, 40.0), st.floats(0.0, 50.0), st.floats(-3.1, 3.1), st.floats(-20, 20), st.integers(60, 400))
def test_fit_finds_the_sine_at_any_part_of_a_cycle(frequency_hz, amplitude, phase, offset, count):
    t = np.arange(count) / 500.0 * max(1.0, 5.0 / frequency_hz)
    y = amplitude * np.sin(2 * math.pi * frequency_hz * t + phase) + offset
    if frequency_hz * t[-1] < 0.7 or frequency_hz * (t[1] - t[0]) > 0.4:
        return
    sine = fit_sine(t, y, frequency_hz)
    assert sine.amplitude == pytest.approx(amplitude, abs=1e-6)
    assert sine.offset == pytest.approx(offset, abs=1e-6)
    if amplitude > 1e-3:
        assert math.cos(sine.phase_rad - phase) == pytest.approx(1.0, abs=1e-6)
    assert sine.at(t, frequency_hz) == pytest.approx(y, abs=1e-6)


def test_fits_standard_deviation_is_the_scatter_of_the_fits():
    rng = np.random.default_rng(5)
    t = np.arange(500) / 500.0
    found = [fit_sine(t, np.sin(31.4 * t) + rng.normal(0, 0.1, t.size), 31.4 / (2 * math.pi)) for _ in range(400)]
    scatter = np.std([sine.amplitude for sine in found])
    assert scatter == pytest.approx(0.1 * math.sqrt(2 / 500), rel=0.12)  # the textbook's value
    assert np.mean([sine.sd for sine in found]) == pytest.approx(scatter, rel=0.12)


@pytest.mark.parametrize(("frequency_hz", "drift"), [(0.8, 0.0), (5.0, 0.02), (11.37, 0.0), (73.3, 0.0)])
def test_an_unknown_frequency_is_found_within_its_standard_deviation(frequency_hz: float, drift: float):
    rng = np.random.default_rng(8)
    t = np.arange(2000) / 500.0
    errors, amplitudes = [], []
    for phase in rng.uniform(-3.0, 3.0, 40):
        y = 2.0 * np.sin(2 * math.pi * frequency_hz * t + phase) + 7.0 + drift * t + rng.normal(0, 0.05, t.size)
        free = fit_free_sine(t, y)
        assert free.is_significant
        errors.append((free.frequency_hz - frequency_hz) / free.sd_frequency_hz)
        amplitudes.append((free.sine.amplitude - 2.0) / free.sine.sd)
    assert max(np.abs(errors)) < 5.0
    assert np.std(amplitudes) == pytest.approx(1.0, rel=0.35)
    assert drift > 0 or np.std(errors) == pytest.approx(1.0, rel=0.35)


def test_noise_is_no_sine_and_neither_is_a_drift():
    rng = np.random.default_rng(9)
    t = np.arange(2000) / 500.0
    found = [fit_free_sine(t, rng.normal(0, 0.05, t.size) + 3.0).is_significant for _ in range(200)]
    assert not any(found)
    assert not fit_free_sine(t, np.zeros(2000)).is_significant
    with pytest.raises(ValueError, match="no record"):
        fit_free_sine(t[:10], t[:10])


@pytest.mark.parametrize("rate", [0.0, 0.01, -0.05])
def test_change_per_cycle_is_the_decay(rate):
    t = np.arange(1000) / 500.0
    y = np.exp(rate * 8.0 * t) * np.sin(2 * math.pi * 8.0 * t)
    assert change_per_cycle(t, y, 8.0) == pytest.approx(abs(rate), abs=2e-3)


def test_a_beat_does_not_count_as_settled():
    t = np.arange(1000) / 500.0
    beat = np.sin(2 * math.pi * 8.0 * t) + 0.2 * np.sin(2 * math.pi * 8.5 * t)
    assert change_per_cycle(t, beat, 8.0) > 0.01


@given(st.binary(max_size=200), st.integers(1, 7))
def test_parsers_take_any_bytes(data, step):
    for parser in (LineParser(column=0, separator=","), RecordParser(marker=b"\xa5\x5a", form="<i", checksum=True)):
        for at in range(0, len(data), step):
            parser.feed(data[at : at + step])


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=20), st.binary(max_size=9), st.integers(1, 11))
def test_records_are_found_again_after_rubbish(values, rubbish, step):
    parser = RecordParser(marker=b"\xa5\x5a", form="<i", checksum=True)
    rubbish = rubbish.replace(b"\xa5", b"")
    stream = rubbish
    for value in values:
        body = value.to_bytes(4, "little", signed=True)
        stream += b"\xa5\x5a" + body + bytes([sum(body) & 0xFF])
    found = [v for at in range(0, len(stream), step) for v in parser.feed(stream[at : at + step])]
    assert found == values


def sine_probe(amplitude=1.5, frequency_hz=8.0):
    return lambda t: amplitude * np.sin(2 * math.pi * frequency_hz * t)


@pytest.mark.parametrize("form", ["line", "binary"])
@pytest.mark.parametrize("expose", [PtyPort, TcpPort])
def test_reads_the_amplitude(form, expose):
    device = GaugeDevice(sine_probe(), form=form)
    port = expose(device)
    scale = 1.0 if form == "line" else 1e-4
    gauge = LineGauge("table", {"port": getattr(port, "path", None) or port.url, "format": form, "scale": scale})
    gauge.connect()
    reading = gauge.read(8.0, duration_s=0.5)
    assert reading.value == pytest.approx(1.5, abs=5 * reading.sd)
    assert reading.sd == pytest.approx(0.002 * math.sqrt(2 / 250), rel=0.4)
    assert abs(reading.change_per_cycle) < 1e-3
    gauge.close()
    port.close()
    device.shut_down()


def test_table_and_response_of_the_rig(rig, shaker):
    shaker.set(3.0, 1.0)
    time.sleep(1.5)
    found = {}
    for role in ("table", "response"):
        gauge = LineGauge(role, {"port": f"sim://gauge-{role}", "role": role})
        gauge.connect()
        found[role] = gauge.read(3.0, duration_s=1.0)
        gauge.close()
    assert found["table"].value == pytest.approx(1.0, rel=5e-3)
    t = rig.clock() - 1.0 + np.arange(500) / 500
    assert found["response"].value == pytest.approx(fit_sine(t, rig.rig.response_mm(t), 3.0).amplitude, rel=0.05)
    assert found["response"].value > 1.05 * found["table"].value  # on its way to the first mode


@pytest.fixture
def streaming():
    device = GaugeDevice(sine_probe())
    port = TcpPort(device)
    gauge = LineGauge("table", {"port": port.url})
    yield device, gauge
    gauge.close()
    port.close()
    device.shut_down()


def read_for(seconds, gauge):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        gauge.read(8.0, duration_s=0.3)


FAULTS = {
    "silent": (TransportError, "sends no readings"),
    "stuck": (DeviceRefused, "stuck at"),
    "rubbish": ((DeviceRefused, TransportError, ProtocolError), "."),
    "hang_up": (TransportError, "lost"),
    "drops": (ProtocolError, "readings/s"),
    "slow": (ProtocolError, "readings/s"),
    "out_of_range": (DeviceRefused, "out of range"),
    "drifting_gain": (None, ""),  # nothing in one gauge's signal shows it: two gauges must disagree
    "noisy": (None, ""),
    "clips": (DeviceRefused, "clipped"),
    "spikes": (None, ""),
    "no_line_end": (TransportError, "sends no readings"),
    "half_lines": ((DeviceRefused, ProtocolError), "."),
    "bursts": (None, ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named_and_end_with_a_new_connection(streaming, fault):
    device, gauge = streaming
    error, words = FAULTS[fault]
    gauge.connect()
    assert set(FAULTS) == set(device.faults.table)
    device.faults.inject(fault, count=1 if fault == "hang_up" else None)
    time.sleep(0.9 if fault in ("drops", "slow") else 0.35)
    if error is None:
        reading = gauge.read(8.0, duration_s=0.3)
        expected = 1.8 if fault == "drifting_gain" else 1.5
        assert reading.value == pytest.approx(expected, abs=max(0.01, 5 * reading.sd))
    else:
        with pytest.raises(error, match=words):
            read_for(20, gauge)
    device.faults.clear()
    gauge.connect()
    assert gauge.read(8.0, duration_s=0.3).value == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize("fault", [None, "spikes"])
def test_a_gauge_finds_the_excitation_that_nobody_stated(streaming, fault):
    device, gauge = streaming
    gauge.connect()
    if fault is not None:
        device.faults.inject(fault, count=None)
    found = gauge.find_sine(duration_s=1.0)
    assert found.is_significant
    assert found.frequency_hz == pytest.approx(8.0, abs=max(5 * found.sd_frequency_hz, 0.02))
    assert found.value == pytest.approx(1.5, abs=max(5 * found.sd, 0.01))
    with pytest.raises(UsageError, match="no record"):
        gauge.find_sine(duration_s=0.01)


def test_a_record_of_a_window_has_the_phase_that_the_host_saw(streaming):
    _, gauge = streaming
    gauge.connect()
    start_s = time.monotonic() + 0.1
    record = gauge.record(start_s=start_s, duration_s=0.6)
    assert record.values.size == pytest.approx(300, abs=15)
    assert np.all(np.diff(record.t_s) > 0)
    sine = fit_sine(record.t_s + start_s, record.values, 8.0)
    # Blocks come each 20 ms and the machine may be busy: the least delay counts.
    assert sine.amplitude == pytest.approx(1.5, abs=0.1)
    assert abs(sine.phase_rad) < 2 * math.pi * 8.0 * 0.02


@pytest.mark.parametrize("fault", ["silent", "hang_up"])
def test_a_record_of_a_silent_gauge_is_an_error_at_once(streaming, fault):
    device, gauge = streaming
    gauge.connect()
    device.faults.inject(fault, count=1 if fault == "hang_up" else None)
    with pytest.raises(TransportError, match=r"sends no readings|lost"):
        gauge.record(start_s=time.monotonic(), duration_s=0.4)


@pytest.mark.parametrize(
    ("values", "ends"),
    [
        (np.round(np.sin(np.arange(500) / 10) * 5), 0),  # five steps: a coarse gauge, not a clipped one
        (np.round(np.sin(np.arange(500) / 10) / 2), 0),
        (np.clip(np.sin(np.arange(500) / 10), -2, 0.7), 1),
        (np.clip(np.sin(np.arange(500) / 10), -0.7, 0.7), 2),
        (np.zeros(500), 0),
        (np.sin(np.arange(20)), 0),
    ],
)
def test_only_what_piles_up_at_an_end_is_clipped(values, ends):
    assert len(clipped_ends(values)) == ends


@pytest.mark.parametrize("call", ["read", "record", "find_sine"])
def test_a_gauge_that_another_thread_closes_meanwhile_is_not_connected(streaming, call):
    """Each asks for more than there is, so it waits when the other thread comes."""
    _, gauge = streaming
    gauge.connect()
    calls = {
        "read": lambda: gauge.read(8.0, duration_s=50.0),
        "record": lambda: gauge.record(start_s=time.monotonic(), duration_s=50.0),
        "find_sine": lambda: gauge.find_sine(duration_s=50.0),
    }
    met = []

    def wait():
        try:
            calls[call]()
        except Exception as exc:
            met.append(exc)

    waiting = threading.Thread(target=wait)
    waiting.start()
    gauge.close()
    waiting.join(60)
    assert not waiting.is_alive()
    assert isinstance(met[0], TransportError), met
    assert "not connected" in str(met[0])


def test_a_gauge_may_be_connected_anew_while_another_thread_reads(streaming):
    """Its record of before is thrown away under the reader's eyes: an error of the device at most, never another."""
    _, gauge = streaming
    gauge.connect()
    met, is_over = [], threading.Event()

    def read_on():
        while not is_over.is_set():
            try:
                gauge.read(8.0, duration_s=0.2)
            except (TransportError, ProtocolError, DeviceRefused):
                continue
            except Exception as exc:
                met.append(exc)

    reading = threading.Thread(target=read_on)
    reading.start()
    for _ in range(5):
        gauge.connect()
    is_over.set()
    reading.join(60)
    assert not reading.is_alive()
    assert met == []


def test_a_dead_gauge_does_not_connect(streaming):
    device, gauge = streaming
    device.faults.inject("silent")
    with pytest.raises(TransportError, match="sends no readings"):
        gauge.connect()
    device.faults.clear()
    device.faults.inject("out_of_range")
    with pytest.raises(ProtocolError, match="without numbers"):
        gauge.connect()


@pytest.mark.parametrize(("frequency_hz", "duration_s"), [(0.0, 1.0), (1.0, 0.5), (8.0, 100.0)])
def test_records_that_make_no_sense(streaming, frequency_hz, duration_s):
    with pytest.raises(UsageError):
        streaming[1].read(frequency_hz, duration_s=duration_s)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"format": "json"}, "g.format"),
        ({"record": "<ii"}, "g.record"),
        ({"record": "?!"}, "g.record"),
        ({"marker": "xyz"}, "g.marker"),
        ({"marker": ""}, "g.marker"),
        ({"rate_hz": 0}, "g.rate_hz"),
        ({"role": "ceiling"}, "g.role"),
    ],
)
def test_wrong_settings(changes, key):
    with pytest.raises(ConfigError) as caught:
        LineGauge("g", {"port": "sim://gauge-table", **changes})
    assert str(caught.value).startswith(key)
