"""What adapting to a person brings: on simulated styles, and on people of a public set."""
