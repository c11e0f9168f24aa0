"""One model file in every runtime: the same answers, and what a step takes there.

`make runtimes` and `make arm`; docs/any-runtime.md shows the tables.
"""
