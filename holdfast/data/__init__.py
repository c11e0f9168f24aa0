"""For: recordings -> critical points -> balanced windows; sets, and the metrics of answers.
May import: step (the filter bank that finds critical points), edge_runtime, core.
Begin with: datasets/__init__.py, where `load` (`holdfast.load_set`) finds a set and reads it.

recording.py has what is read, datasets/ a reader a format, critical_points.py looks for the moments
at which a grip changes, windows.py labels windows of the eight classes and balances them.
"""
