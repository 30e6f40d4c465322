"""What happened at a step, as every estimator reports it."""

OK, REPAIRED, MISSING, DIVERGED, STARTING = range(5)
STATUS_NAMES = ("ok", "repaired", "missing", "diverged", "starting")
