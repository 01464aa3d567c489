"""The line between recorded bytes and typed data: bounds on what decoding costs, and what decoders may raise."""
