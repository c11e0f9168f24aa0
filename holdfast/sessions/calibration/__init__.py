"""Calibration for `holdfast calibrate`: reads loads beside fields, fits, judges on unseen data."""
