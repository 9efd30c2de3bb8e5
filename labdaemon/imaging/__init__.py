"""RAW file -> linear pixels -> dots and coded targets: what a sharp frame shows, found without help."""
