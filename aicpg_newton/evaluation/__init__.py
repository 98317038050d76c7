"""Watching and judging controllers."""
