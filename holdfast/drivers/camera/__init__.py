"""A camera that films the object: lossless video and the tracks of printed tags.

It is a bench instrument, not part of the hand. One depthai graph (graph.py) serves every source of
frames (sources.py): an OAK camera, frames on disk, or a recorded folder. It leaves a folder
(recording.py) that numpy alone can read.
"""
