"""Intents: what a target may be trying to do, as motion functions and the laws of their parameters.

This package will learn a bank of intents from recorded tracks (motion functions, parameter laws, noises,
birth priors and the Markov generator between them), score it against labels, and store it in files that the
compiled core in `jink.estimators` runs without torch. It imports `jink.estimators` and nothing further up. It
is empty for now: the learner arrives in a later release, and `intent-imm` uses library motions until then.
"""
