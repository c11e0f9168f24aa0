"""Where samples come from: USB and I2C bridges, a camera, recordings, and a virtual hand."""

if __name__ == "drivers":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)
