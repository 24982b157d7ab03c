"""On the beat: the accents of a dance, the beats of its music, and how early or late one is to the other."""
