"""What survives a power cut: the journal (SQLite) and the frames that it vouches for."""
