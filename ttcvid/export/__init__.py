"""Results as files of other tools: each module writes one format from the tables of a run."""
