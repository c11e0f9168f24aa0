"""Logs of other programs as columns: `find.py` says which files are logs, and reads each."""
