"""The tables of the documentation's pages, written from the studies' JSON files."""
