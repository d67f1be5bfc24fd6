"""From a journal to a run file: columns, events, quality."""
