"""Train a network: python train.py --task flat. See --help for every setting."""

from aicpg_newton.train import command

if __name__ == "__main__":
    command()
