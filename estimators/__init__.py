"""Estimators: motions, sensors, filters and the bank that runs them together."""
