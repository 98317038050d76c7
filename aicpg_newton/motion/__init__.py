"""Motion capture to gait cycles: Acclaim files, retargeting to the humanoid, stride frequency, cycles and pictures.

``python -m aicpg_newton.motion`` fits the pattern network from clips; :mod:`aicpg_newton.gait.cpg` holds the network.
"""
