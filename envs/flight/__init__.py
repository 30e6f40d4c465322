"""How a target flies: legs, dwell times, limits, plants."""
