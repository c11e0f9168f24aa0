"""The same trials, changed in one nuisance at a time: what the very model file makes of them."""
