"""Files that hold a table and are not plain text: each is read into a `daq.imports.table.Table`."""
