"""For: what learns: plan, folds, fitting, judging. `data` makes the windows that it fits.
May import: data, step, edge_runtime, core.
Begin with: fitting.py, from sets to an artifact; crossval.py answers for people it never saw.

plan.py has what they choose by default. Nothing here imports export, which reads the artifact.
train.py is `holdfast train` as a script.
"""

from holdfast.core.links import link, link_old_names

if __name__ == "training":  # imported by the link at the top of a checkout
    link(__name__)
else:
    link_old_names(__name__, "core", ["progress"])
    for_data = ["critical_points", "datasets", "fixture", "lifts", "metrics"]
    link_old_names(__name__, "data", [*for_data, "recording", "timeline", "windows"])
