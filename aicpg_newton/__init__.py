"""AI-CPG: adaptive imitated central pattern generators for bipedal locomotion, on NVIDIA Newton and Warp."""

import os

__version__ = "0.1.0"

# Torch's threads wait for one another by spinning, as long as the operating system lets them. Where two trainings share
# the cores, each waits for threads that the other's spinning ones keep off: 29 s for what takes 1.1 s alone, and 1.9 s
# if they give up early. GNU's OpenMP reads this when torch is imported; what the user has set is obeyed.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")

# rsl_rl imports a package that raises where git is not installed, if it is not told to be quiet.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
