"""An agent inside a filter: what it sees of a measurement, its network, and the noise it chooses."""
