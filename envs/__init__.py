"""Environments, simulated and recorded: where targets and measurements come from."""
