"""Forest, network and committee of several sizes on whole streams, also of styles left out."""
