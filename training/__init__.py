"""The composition root: command line, benchmark, reports and (later) training.

Everything that puts the other packages together lives here: the `jink` command, the suites that compare
estimators on the same truth and noise, the rows they write and the tables made from those rows. It may import
`jink.estimators`, `jink.intent` and `jink.envs`; none of them may import it.
"""
