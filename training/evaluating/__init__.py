"""A model file on whole streams: what a user feels of it, beside its rivals, and what a hand makes of it."""

MOST_FALSE_PER_MIN = 0.5
"""False alarms a minute that are allowed where a confidence is chosen, unless told."""
