"""Scenes: the physics of a hand, an object and what disturbs them. Nothing runs that the card does
not name.

card.py reads an experiment card, protocol.py draws its trials, core.py moves them, record.py is
what they leave behind. effect.py says what an effect is; effects.py lists them all.
"""
