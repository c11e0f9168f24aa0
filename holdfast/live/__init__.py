"""For: a live run: sources, the loop, outputs, links to a hand, and the page.
May import: drivers, simulation (for the virtual hand), edge_runtime, core.
Begin with: run.py, which joins them; loop.py reads, answers and passes on.
"""
