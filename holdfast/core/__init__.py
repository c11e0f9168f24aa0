"""The domain and its files: contract, errors, units, trial files. It imports no other package."""
