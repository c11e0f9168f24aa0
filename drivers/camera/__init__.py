"""A camera that watches the object: lossless video and the tracks of printed tags. A bench
instrument, not on the hand.

One graph of depthai (graph.py) whatever the frames come from (sources.py): an OAK camera, frames on
disk, or a folder recorded before. It leaves a folder (recording.py) that is read with numpy alone.
"""
