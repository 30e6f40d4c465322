"""How a surge is drawn: laws and their checks."""
