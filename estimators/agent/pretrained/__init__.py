"""Policies that ship with the package; `docs/agent.md` says by which command each was made."""
