"""The humanoid: joints, motors, geometry and how it moves in space. Knows nothing of physics engines or learning."""
