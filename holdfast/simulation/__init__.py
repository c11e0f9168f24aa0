"""Scenes: the physics of a hand, an object and the people who disturb them.

card.py reads an experiment card, protocol.py draws its trials, script.py turns them into inputs of
core.py, run.py steps them in batches, truth.py reads the events, folder.py writes all of it. A card
runs only the effects that it names: effect.py says what an effect is, effects.py lists them all.
"""
