"""Parts of a frame."""
