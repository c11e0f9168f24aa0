"""Move the wall: what could tell a fast hand-over from a pull, one idea at a time, each with what
it costs."""
