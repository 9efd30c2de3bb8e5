"""The published method, whole: the baseline that the default is held against."""
