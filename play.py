"""Play a trained network: python play.py --checkpoint runs/flat/.../model_2999.pt. See --help for every option."""

from aicpg_newton.play import command

if __name__ == "__main__":
    command()
