"""Point filters of the combining stage: pure functions on arrays."""
