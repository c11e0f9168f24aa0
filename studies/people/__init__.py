"""How often a model alarms, and how far the grip squeezes, in plain lifts by people."""
