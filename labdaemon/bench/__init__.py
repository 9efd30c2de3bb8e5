"""How good and how fast the measurement is, on frames whose truth is known, and how the daemon bears faults."""
