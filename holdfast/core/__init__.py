"""For: what all rooms share: the contract, errors, units, trial files, hand cards.
May import: no other room.
Begin with: contract.py, two screens that explain the whole domain.
"""
