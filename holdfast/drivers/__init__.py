"""Where samples come from: USB and I2C bridges, a camera, recordings, and a virtual hand."""
