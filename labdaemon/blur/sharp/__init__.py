"""The target at rest: its shape or texture, the grain of its paper, and how much each of its pixels tells."""
