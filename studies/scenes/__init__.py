"""The study of scenes: what a forest tells on them, beside what, and on trials, objects and styles
never met."""
