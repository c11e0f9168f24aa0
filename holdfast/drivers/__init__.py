"""For: where samples come from: USB and I2C bridges, a camera, recordings, and a virtual hand.
May import: edge_runtime, core.
Begin with: hand.py, where a scan of all fingers becomes a sample.
"""

if __name__ == "drivers":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)
