"""AI-CPG: adaptive imitated central pattern generators for bipedal locomotion, on NVIDIA Newton and Warp."""

__version__ = "0.1.0"
