"""One model file in every runtime: the same answers, and what a step takes there.

`make bench NAME=runtimes` and `make bench NAME=arm`; docs/any-runtime.md shows the tables.
"""
