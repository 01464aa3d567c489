"""Which topics are those of lidars and cameras, and which nodes made of theirs."""
