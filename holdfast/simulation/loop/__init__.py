"""For: the closed loop: a model answers while the hand holds, and hand and people react.
May import: simulation/scenes, and below.
Begin with: closed_loop.py; people.py, physics.py, sensing.py and drive.py are its parts.
"""
