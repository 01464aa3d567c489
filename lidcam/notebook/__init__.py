"""Results to work on in Python: what people look at in a notebook."""
