"""`python -m dashpot`: the command of the same name."""

from dashpot.app.cli import main

if __name__ == "__main__":
    main()
