"""Let controllers move: roll-outs, and what play.py does."""
