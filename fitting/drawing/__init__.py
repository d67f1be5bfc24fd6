"""Friction curves as pictures: of each law, of the measured points and the measured curve."""
