"""The command line: the only place where rooms meet; it imports them lazily, none imports it."""
