"""Motion seen through known windows of non-whole cycles: signed vectors, orbits and the sense of their turning."""
