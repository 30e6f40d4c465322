"""What learned intents are compared with: each finds labels in unlabelled tracks, by `fit` and `segment`."""
