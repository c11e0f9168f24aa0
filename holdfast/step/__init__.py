"""The definition of one step."""
