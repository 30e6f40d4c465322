"""The benchmark of simulated suites: one ladder of estimators from raw measurement to bound, scored run by run."""
