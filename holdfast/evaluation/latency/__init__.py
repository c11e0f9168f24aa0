"""`holdfast bench latency`: one decision next to other implementations, and its budgets."""
