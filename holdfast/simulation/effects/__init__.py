"""For: what a scene may name beside its physics, one law each: magnet, chip, sensors, shakes.
May import: edge_runtime, core.
Begin with: effect.py, what an effect is, and the list of all in their order; those of the contacts
themselves are in physics/contacts.py.
"""
