"""A camera that films the object: lossless video and the tracks of printed tags.

It is a bench instrument, not part of the hand. One depthai graph (graph.py) serves an OAK camera
and frames on disk. It leaves a folder (recording.py) that numpy alone can read, and in which
onset.py finds when a slip began.
"""
