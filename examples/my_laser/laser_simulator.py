"""A simulator on a TCP port that speaks the protocol of the laser, so that the driver is tested on a wire."""

from __future__ import annotations

import socket
import threading
import time

import numpy as np
from my_laser import RATE_HZ


class LaserSimulator:
    """Sends the displacement of a table that moves with the given amplitude and frequency.

    Parameters
    ----------
    amplitude_mm, frequency_hz
        Motion of the table, zero to peak.
    """

    def __init__(self, amplitude_mm: float, frequency_hz: float) -> None:
        self._amplitude, self._frequency = amplitude_mm, frequency_hz
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> LaserSimulator:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._server.close()
        self._thread.join(5.0)

    def _serve(self) -> None:
        rng = np.random.default_rng(0)
        try:
            connection, _ = self._server.accept()
        except OSError:
            return  # closed before a driver came
        begin, sent = time.monotonic(), 0
        with connection:
            while not self._ended.wait(0.01):
                due = int((time.monotonic() - begin) * RATE_HZ)
                t = np.arange(sent, due) / RATE_HZ
                y = self._amplitude * np.sin(2 * np.pi * self._frequency * t) + rng.normal(0, 0.001, len(t))
                sent = due
                try:
                    connection.sendall("".join(f"D{value:+08.4f}\n" for value in y).encode())
                except OSError:
                    return
