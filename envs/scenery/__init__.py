"""Parts of a multi-target scene: sensors, regions, paths, data."""
