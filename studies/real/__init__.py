"""The main study on public recordings: people held out, exported, verified."""
