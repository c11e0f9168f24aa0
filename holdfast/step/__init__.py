"""For: the definition of one step, which training and hand share, and the artifact of learners.
May import: edge_runtime, core.
Begin with: spec.py, what a step is made for; features.py, from samples to features as nodes of it.

guard.py, detectors.py and history.py are the parts of that graph, pooled.py its features over the
sensors of a side; learner.py and network.py turn learners into whole votes, heads.py has what is
made of votes, artifact.py the folder that holds fitted learners.
"""
