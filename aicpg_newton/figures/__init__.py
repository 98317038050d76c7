"""The figures of the paper, from results on disk."""
