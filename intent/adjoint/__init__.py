"""The recursion of the differentiable bank as compiled code, with its gradient written by hand.

Forward it is the cycle of `jink.estimators` for position measurements; backward it is the adjoint of that cycle, from
the last row to the first. A test holds both to the torch operations of `jink.intent.torch_scan`.
"""
