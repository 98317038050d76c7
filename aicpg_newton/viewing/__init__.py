"""Seeing the humanoid: recordings and filmstrips without a display, and live viewers.

Everything here takes poses (root position, root rotation, joint angles) and knows neither engines nor environments, so
that a simulation, a motion capture clip and a made-up movement are shown in the same way.
"""
