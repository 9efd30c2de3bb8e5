"""Closed-form spectra of dot, lens, pixel and motion, and the darkness at a sensor's pixels that they make."""
