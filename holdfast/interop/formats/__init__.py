"""Files of other programs, read and written: one module each, which alone imports its library."""
