"""Named scenarios and their parameters."""
