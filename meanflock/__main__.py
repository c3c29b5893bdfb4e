"""`python -m meanflock`: the `meanflock` command."""

from meanflock.cli.__main__ import main

if __name__ == "__main__":
    main()
