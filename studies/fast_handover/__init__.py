"""The fast hand-over study: what tells a fast hand-over from a pull, one change at a time."""
