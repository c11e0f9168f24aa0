"""What the simulation is worth outside itself: `python -m studies transfer`."""
