"""The main study on public recordings of people: cross-validated with people held out, exported,
verified."""
