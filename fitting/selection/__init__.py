"""Which law: screening, evidence, equivalence, ranking, verdict."""
