"""`python -m meanflock`: the `meanflock` command."""

from groundstation.command import main

if __name__ == "__main__":
    main()
