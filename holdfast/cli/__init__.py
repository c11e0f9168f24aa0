"""For: the command line: parsers and calls, no logic.
May import: all other rooms.
Begin with: main.py, the list of verbs.
"""
