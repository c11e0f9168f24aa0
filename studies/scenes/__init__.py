"""The study of scenes: forests and baselines on unseen trials, objects and styles."""
