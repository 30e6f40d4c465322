"""Parts of the contract test of estimators."""
