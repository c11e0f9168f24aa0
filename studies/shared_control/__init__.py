"""What holding on costs: grip controllers in a closed loop, on styles seen and never seen."""
