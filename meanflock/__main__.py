"""`python -m meanflock`: the `meanflock` command."""

from meanflock.groundstation.command import main

if __name__ == "__main__":
    main()
