"""For: other people's files, in and out: formats/ reads and writes them, the rest understands logs.
May import: data and below.
Begin with: understand.py, what a foreign log says; trials.py makes trials of it.
"""
