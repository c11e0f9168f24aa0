"""Other people's file formats: one module each, which alone imports that format's library."""
