"""The command line: the only place where rooms meet. Imports them lazily; imported by nobody."""
