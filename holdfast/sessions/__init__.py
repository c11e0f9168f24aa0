"""For: work with a person: record, study, calibrate, adapt, repair.
May import: live, evaluation, export and below.
Begin with: recorder/session.py, trial after trial with a person.
"""
