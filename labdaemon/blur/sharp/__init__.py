"""The target at rest: its shape or texture, the paper texture, and the weight of each pixel."""
