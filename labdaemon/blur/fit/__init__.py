"""Motion whose phase does not show: whole cycles, a declared law, none at all, and what hangs in front of it."""
