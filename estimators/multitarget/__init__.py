"""Many targets and many sensors: scans of unlabelled detections, association and tracks."""
