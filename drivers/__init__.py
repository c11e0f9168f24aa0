"""Where samples come from. Every source yields edge_runtime's Sample; today: replay of a recorded
trial."""
