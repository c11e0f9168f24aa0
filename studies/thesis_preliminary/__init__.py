"""The thesis' preliminary study again: five cases, five learners, on a 20-sensor scene and on
people's recordings."""
