"""``python -m flexhinf`` is the command ``flexhinf``."""

from flexhinf.cli import console

if __name__ == "__main__":
    console()
