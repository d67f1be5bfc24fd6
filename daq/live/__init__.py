"""The live view: a page in the browser, served by a process of its own that reads a recording's journal."""
