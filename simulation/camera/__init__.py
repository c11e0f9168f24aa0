"""A camera before the hand: frames with a tag on the object and one on the hand."""
