"""For: other people's file formats: one module each, which alone imports that format's library.
May import: data and below.
Begin with: understand.py, what a foreign log says; trials.py makes trials of it.
"""
