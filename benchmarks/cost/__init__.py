"""What accuracy costs in time: the surface, point by point."""
