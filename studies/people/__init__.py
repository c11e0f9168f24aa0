"""Real forces of people: how often a model alarms in their lifts, and what our scenes lack."""
