"""Environments, simulated and recorded: where targets and measurements come from.

Importing this package registers the environments: ``gymnasium.make("jink.envs:jink/ManoeuvringTarget-v0")``.
"""

from jink.envs.registration import register

register()
