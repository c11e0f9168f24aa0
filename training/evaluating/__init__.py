"""A model file on whole streams: what a user feels of it, beside its rivals, and what a hand makes of it."""
