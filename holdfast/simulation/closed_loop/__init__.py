"""The closed loop: hands that answer, through the very model file, while the scene goes on."""
