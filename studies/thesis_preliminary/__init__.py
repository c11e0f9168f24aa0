"""The thesis' preliminary study, repeated on a simulated 20-sensor hand and on real recordings."""
