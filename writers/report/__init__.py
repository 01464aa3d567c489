"""A page about a result: what it is made of is gathered frame by frame, in bounded memory."""
