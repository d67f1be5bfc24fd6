"""The run file and the journal: the contract on disk."""
