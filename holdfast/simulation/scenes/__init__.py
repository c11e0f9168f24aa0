"""For: scenes: a card is read, trials are drawn, scripted, stepped, and written with their truth.
May import: simulation/physics, the table of simulation/actions, and below.
Begin with: scene.py, a scene and its trials; scene_file.py reads the card.
"""
