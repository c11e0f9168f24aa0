"""One page that shows a live run: a separate process serves it, and the loop never waits for it.

loop --(non-blocking socket pair)--> process.py --(HTTP, server-sent events)--> browsers
"""
