"""How events and commands travel: throughput, latency, subscribers that stall, and hostile messages."""
