"""The MLX90393 (Melexis): its registers and commands, its driver, and its emulation."""
