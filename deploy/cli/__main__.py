"""`python -m deploy.cli`."""

from deploy.cli import program

if __name__ == "__main__":
    program()
