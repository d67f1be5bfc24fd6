"""What is written: page, pictures, tables, the stage in the run file."""
