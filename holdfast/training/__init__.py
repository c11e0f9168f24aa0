"""Recordings -> critical points -> balanced windows -> forest -> artifact.

The centre is four files: datasets/thesis.py reads recordings, critical_points.py looks for the
moments at which a grip changes, windows.py labels windows of the eight classes and balances them,
crossval.py computes features, trains the forest and answers for people it never saw. fitting.py
joins the four, and plan.py has what they choose by default.
"""

if __name__ == "training":  # imported by the link at the top of a checkout
    from holdfast.core.links import link

    link(__name__)
