"""The central pattern generator, and the imitated gait as motion of the whole body."""
