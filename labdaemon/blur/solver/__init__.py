"""Least squares on patches, with each channel's light eliminated."""
