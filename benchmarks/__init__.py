"""What accuracy costs in time: speed as ratios taken in one run, beside the machine's own jitter."""
