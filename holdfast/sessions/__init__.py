"""Work with a person: record, study, calibrate, adapt, repair."""
