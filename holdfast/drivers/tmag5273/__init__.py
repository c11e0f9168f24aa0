"""The TMAG5273 (Texas Instruments): its registers, its driver, and its emulation."""
