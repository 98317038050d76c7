"""PPO by rsl_rl on the AI-CPG environment."""
