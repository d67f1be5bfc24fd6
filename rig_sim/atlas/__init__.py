"""The figures of the thesis, redrawn: each a picture, and a table of what the thesis says and what is computed."""
