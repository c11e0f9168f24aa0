"""Adapting a model file to one person, from a short recording."""
