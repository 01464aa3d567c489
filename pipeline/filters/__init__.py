"""What is done to a cloud's points: pure functions on arrays that the combining stage strings together."""
