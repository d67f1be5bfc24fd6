"""The outputs: page, pictures, tables, the stage in the run file."""
