"""A model file on whole streams: what a user feels of it, beside what stands next to it, and what a hand makes of it."""
