"""The second physics: the shipped model and controller in a world that is not ours (MuJoCo).

For testing only: nothing is trained, chosen or tuned here (tests/benchmarks/test_world.py).
"""
