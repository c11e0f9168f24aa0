"""A live run: sources, the loop, outputs, links to a hand, and the page."""
