"""The command line: parsers and calls."""
