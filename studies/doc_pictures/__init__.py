"""Pictures of the documentation that no report draws: tools/doc_pictures.py lists them."""
