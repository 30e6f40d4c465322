"""Truth of scenarios whose results are published."""
