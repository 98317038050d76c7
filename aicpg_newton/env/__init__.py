"""What is to be learned: tasks, commands, rewards, observations, ways to control, and the step that joins them."""
