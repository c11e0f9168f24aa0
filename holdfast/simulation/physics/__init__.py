"""For: one object between contacts: what is there, and one implicit step of it.
May import: simulation/effects, and below.
Begin with: solver.py, the step; body.py has its arrays, objects.py the objects and the hand.
"""
