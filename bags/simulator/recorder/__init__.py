"""What is written: messages, truth, and the files that hold them."""
