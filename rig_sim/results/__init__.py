"""A function for every command of ``rig-sim``: a scene and the flags as keywords in, a result with its picture out."""
