"""Intents: what a target may be trying to do, as motion functions and the laws of their parameters.

`IntentLearner` (in `jink.intent.learner`, needs torch) learns a bank of intents from unlabelled tracks: motion
functions, laws of their parameters, noises, birth priors and the Markov generator between them. `IntentModel` (in
`jink.intent.model`) is what it leaves: it runs in the compiled core of `jink.estimators` without torch, labels tracks
(`segmentation`), forecasts (`forecasting`) and is kept in files (`model_file`). The package imports `jink.estimators`
and nothing further up.
"""
