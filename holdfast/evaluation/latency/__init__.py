"""`holdfast bench latency`: the time of one decision on this machine, and its budgets."""
