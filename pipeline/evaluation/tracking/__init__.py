"""How well objects are followed from frame to frame: HOTA, CLEAR MOT, IDF1, AMOTA, and turns that nobody made."""
