"""Scenes: the physics of a hand, an object and what disturbs them. Nothing is here yet."""
