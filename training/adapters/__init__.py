"""Filters of other packages with the interface of ours, and ours with theirs."""
